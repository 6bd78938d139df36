"""YOLOv9 (Wang, Yeh, Liao, ECCV 2024) to train and export, through the MIT package ``libreyolo``.

Its YOLOv9 comes from MultimediaTechLab/YOLO, the authors' own MIT release. Importing the package also imports
its other model families; none is under the GPL or AGPL (its NOTICE names what is not MIT).
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.boxes import BoxStyle, Detections2D
from eldenet.deploy.predictor import check_frame
from eldenet.perception.postprocess import fit_image, select_boxes
from eldenet.system.checks import one_of
from eldenet.system.files import read_yaml

SIZES = ("t", "s", "m", "c")
_STRIDE = 32
_OPSET = 17


@dataclass(frozen=True)
class YoloTraining:
    """How to train a YOLOv9.

    Attributes:
        epochs: passes over the training images; the last sixth is without mosaics.
        batch: images per update.
        learning_rate: of AdamW, decaying linearly.
        mosaic: share of training images that are composed of four.
        auxiliary: weight of YOLOv9's auxiliary branch in training (0.25 in the package; a third slower).
        workers: processes that load images.
        device: "cpu", "cuda" or another torch device.
        seed: of weights and augmentation.
    """

    epochs: int
    batch: int = 8
    learning_rate: float = 0.002
    mosaic: float = 0.0
    auxiliary: float = 0.0
    workers: int = 0
    device: str = "cpu"
    seed: int = 0


class LibreYoloDetector:
    """YOLOv9 as a detector in torch; :meth:`export` writes the file for :class:`OnnxDetector`.

    Args:
        weights: a ``.pt`` file that :meth:`train` wrote (read as data, not executed); None: random weights.
        names: of the classes; None: those of ``weights``.
        size: "t", "s", "m" or "c"; ignored if ``weights`` are given.
        input_size: ``(height, width)`` of the network's input [px], multiples of 32.
        threshold: detections below this score are dropped.
        nms: IoU from which the worse of two boxes of a class is dropped.
        between_classes: the same for two boxes of different classes; 1: keep both.
        box_style: how its boxes enclose objects.
        seed: of random weights.

    Raises:
        FileNotFoundError: ``weights`` do not exist (nothing is downloaded).
        ValueError: ``libreyolo`` is not installed, or a size or the names are wrong.
    """

    def __init__(
        self,
        weights: str | Path | None = None,
        *,
        names: Sequence[str] | None = None,
        size: str = "t",
        input_size: tuple[int, int] = (192, 320),
        threshold: float = 0.3,
        nms: float = 0.5,
        between_classes: float = 0.85,
        box_style: BoxStyle = "tight",
        seed: int = 0,
    ) -> None:
        one_of("size", size, SIZES)
        if any(side < _STRIDE or side % _STRIDE for side in input_size):
            raise ValueError(f"input_size={tuple(input_size)}: give (height, width), multiples of {_STRIDE}")
        if weights is not None and not Path(weights).is_file():
            raise FileNotFoundError(
                f"weights={weights} does not exist: give a .pt file of libreyolo, or null"
            )
        if weights is None and not names:
            raise ValueError("neither weights nor names are given: give names=[...] of the classes")
        self.model = _build(weights, names, size, seed)
        self.names = tuple(str(self.model.names[number]) for number in range(self.model.nb_classes))
        if names is not None and tuple(names) != self.names:
            raise ValueError(f"names={list(names)}, but {weights} has {list(self.names)}: leave names out")
        self.input_size = (int(input_size[0]), int(input_size[1]))
        self.threshold, self.nms, self.box_style = threshold, nms, box_style
        self.between_classes = between_classes

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """Find objects in ``(H, W, 3)`` uint8 RGB."""
        import torch

        check_frame(frame)
        fitted, placement = fit_image(frame, self.input_size, self.model.letterbox_pad)
        network = self.model.model.eval()
        device = next(network.parameters()).device
        image = torch.from_numpy(np.ascontiguousarray(fitted.transpose(2, 0, 1)[None])).to(device) / 255.0
        with torch.inference_mode():
            raw = network(image)["predictions"][0].T.double().cpu().numpy()
        xyxy, best, label = select_boxes(
            raw[:, :4], raw[:, 4:], placement, threshold=self.threshold, nms=self.nms,
            between_classes=self.between_classes,
        )  # fmt: skip
        return Detections2D(xyxy, best, label, self.names, self.box_style)

    def train(
        self, data: str | Path, folder: str | Path, training: YoloTraining, *, resume: bool = False
    ) -> Path:
        """Train on a data set in YOLO's layout; return the checkpoint, whose weights this detector then uses.

        Args:
            data: the ``data.yaml``; its images must be there (nothing is downloaded).
            folder: for the package's own log and checkpoints.
            training: epochs, batch size ...
            resume: continue from the last checkpoint in ``folder``.

        Raises:
            FileNotFoundError: the data set or the checkpoint to resume does not exist.
            ValueError: the data set has other classes, or names a download.
        """
        data, folder = Path(data).resolve(), Path(folder).resolve()
        last = folder / "weights" / "last.pt"
        for path in (data, *((last,) if resume else ())):
            if not path.is_file():
                raise FileNotFoundError(f"{path} does not exist")
        self._check_classes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.model.train(
                str(data), epochs=training.epochs, batch=training.batch, imgsz=self.input_size,
                lr0=training.learning_rate, optimizer="adamw", device=training.device,
                workers=training.workers, seed=training.seed, project=str(folder.parent), name=folder.name,
                exist_ok=True, resume=str(last) if resume else False, amp=training.device != "cpu",
                eval_interval=0, warmup_epochs=1, no_aug_epochs=max(1, training.epochs // 6),
                mosaic_prob=training.mosaic, aux_weight=training.auxiliary, save_period=training.epochs + 1,
            )  # fmt: skip
        # the package does not document whether its network in memory is the averaged one of the file
        self.model = _build(last, None, self.model.size, training.seed)
        return last

    def _check_classes(self, data: Path) -> None:
        content = read_yaml(data) or {}
        if content.get("download"):
            raise ValueError(f"{data} names a download: fetch the data yourself and remove that line")
        names = content.get("names")
        names = [names[number] for number in sorted(names)] if isinstance(names, dict) else list(names or [])
        if tuple(map(str, names)) != self.names:
            raise ValueError(f"{data} has the classes {names}, but the detector has {list(self.names)}")

    def export(self, path: str | Path) -> Path:
        """Write an ONNX file that :class:`OnnxDetector` reads (fixed size, batch 1, fp32)."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.model.export(
                format="onnx", output_path=str(path), imgsz=self.input_size, opset=_OPSET, simplify=False,
                dynamic=False,
            )  # fmt: skip
        return path


def _build(weights: str | Path | None, names: Sequence[str] | None, size: str, seed: int) -> Any:
    try:
        from libreyolo import LibreYOLO9
    except ImportError as error:
        raise ValueError("LibreYoloDetector needs libreyolo: pip install libreyolo onnx") from error
    import torch

    if weights is not None:
        return LibreYOLO9(str(weights), size=size, device="cpu")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = LibreYOLO9(None, size=size, nb_classes=len(names or ()), device="cpu")
    model.names = dict(enumerate(names or ()))
    return model
