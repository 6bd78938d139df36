"""From light to the image of a cheap camera: exposure, color cast, tone curve, blur, vignette, noise."""

import cv2
import numpy as np

from eldenet.simulation.rendering.mjcf import Draw


def develop(linear: np.ndarray, draw: Draw, seed: tuple[int, ...]) -> np.ndarray:
    """Develop linear RGB ``(H, W, 3)`` float32 into an image ``(H, W, 3)`` uint8.

    ``linear`` is changed in place; ``draw`` chooses exposure, tone and blur, ``seed`` the pixel noise.
    """
    height, width, _ = linear.shape
    level = float(cv2.mean(cv2.resize(linear, (16, 12), interpolation=cv2.INTER_AREA))[1])
    gain = draw.uniform(0.08, 0.30) / max(level, 0.02)  # imperfect automatic exposure
    cast = [gain * draw.uniform(0.9, 1.35), gain, gain * draw.uniform(0.65, 1.15)]
    linear *= np.array(cast, dtype=np.float32)
    if draw.chance(0.6):
        linear *= _vignette(height, width, draw.uniform(0.0, 0.35))
    bleed = draw.uniform(0, 0.02)  # stray light lifts the blacks
    linear += np.float32(bleed * 0.3)
    # a shoulder that lets windows and lamps burn out softly, then the display's gamma
    shoulder = np.float32(draw.uniform(0.6, 1.6))
    bend = shoulder * np.float32(0.35)
    np.divide(linear * (1 + bend), 1 + bend * linear, out=linear)
    np.clip(linear, 0, 1, out=linear)
    image = cv2.pow(linear, 1 / draw.uniform(1.8, 2.4))
    # a soft lens below zero, sharpening above
    edge = draw.uniform(-0.8, 0.8)
    image = cv2.addWeighted(image, 1 + edge, cv2.GaussianBlur(image, (0, 0), 0.7 * width / 160), -edge, 0)
    contrast, saturation = draw.uniform(1.2, 2.1), draw.uniform(0.6, 1.35)
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None]
    middle = np.float32(0.45)
    image = (gray + (image - gray) * np.float32(saturation) - middle) * np.float32(contrast) + middle
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    # the sum of two uniform numbers is close to a Gaussian, and the same on every machine
    noise = rng.integers(0, 256, (2, *image.shape), dtype=np.uint8)
    strength = np.float32(draw.pick((0.004, 0.008, 0.012, 0.02, 0.03)) / 104.0)
    image += (noise[0].astype(np.float32) + noise[1] - np.float32(255)) * strength
    return np.clip(image * 255 + np.float32(0.5), 0, 255).astype(np.uint8)


def develop_photo(
    linear: np.ndarray, draw: Draw, seed: tuple[int, ...], *, outdoors: bool = False
) -> np.ndarray:
    """Develop linear RGB ``(H, W, 3)`` float32 as a phone or a Kinect does: ``(H, W, 3)`` uint8.

    Milder than :func:`develop` in color and noise; dark corners go black and windows burn out.

    The arguments are those of :func:`develop`; ``outdoors`` is by daylight, whose color a camera balances
    well.
    """
    height, width, _ = linear.shape
    level = float(cv2.mean(np.minimum(cv2.resize(linear, (16, 12), interpolation=cv2.INTER_AREA), 2.0))[1])
    gain = draw.uniform(0.10, 0.32) / max(level, 0.02)
    # lamps are warm, and the white balance leaves some of it
    red, blue = ((0.92, 1.08), (0.92, 1.12)) if outdoors else ((0.95, 1.5), (0.75, 1.25))
    cast = [gain * draw.uniform(*red), gain, gain * draw.uniform(*blue)]
    linear *= np.array(cast, dtype=np.float32)
    if draw.chance(0.7):
        linear *= _vignette(height, width, draw.uniform(0.05, 0.4))
    linear *= 1 + linear * np.float32(0.08)
    np.divide(linear, 1 + linear * np.float32(draw.uniform(0.2, 0.6)), out=linear)
    image = cv2.pow(np.clip(linear, 0, 1), 1 / draw.uniform(2.0, 2.4))
    black, white = draw.uniform(0.0, 0.22), draw.uniform(0.78, 1.0)
    image = (image - np.float32(black)) / np.float32(white - black)
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None]
    image = gray + (image - gray) * np.float32(draw.uniform(*((0.7, 1.2) if outdoors else (0.8, 1.6))))
    pixel = width / 160
    if draw.chance(0.4):
        image = cv2.GaussianBlur(image, (0, 0), draw.uniform(0.3, 0.45) * pixel)
    edge = draw.uniform(0.0, 0.6)
    image = cv2.addWeighted(image, 1 + edge, cv2.GaussianBlur(image, (0, 0), pixel), -edge, 0)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    noise = rng.integers(0, 256, (2, *image.shape), dtype=np.uint8)
    grain = noise[0].astype(np.float32) + noise[1] - np.float32(255)
    grain += 2 * cv2.blur(grain, (3, 3))  # of neighbors alike, as the demosaicing leaves it
    strength = np.float32(draw.pick((0.001, 0.002, 0.004, 0.008)) / 125.0)
    image += grain * strength
    return np.clip(image * 255 + np.float32(0.5), 0, 255).astype(np.uint8)


def _vignette(height: int, width: int, amount: float) -> np.ndarray:
    """Brightness ``(H, W, 1)`` that falls toward the corners."""
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, width, dtype=np.float32)[None]
    return (1 - np.float32(amount) * (x * x + y * y) / 2)[..., None]
