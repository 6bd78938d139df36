"""A network and a loss for each YAML file of a loss or a head, for tests of a training step."""

from eldenet.compose import compose, config_folder
from eldenet.configurable import instantiate
from eldenet.losses.base import WeightedSum
from eldenet.model import DepthNet
from eldenet.train import TrainSettings

LOSSES = sorted(path.stem for path in (config_folder() / "loss").glob("*.yaml"))
HEADS = sorted(path.stem for path in (config_folder() / "model" / "head").glob("*.yaml"))
CHOICES = [
    *([f"loss={name}"] for name in LOSSES if name != "ssim_nll"),
    *([f"model/head={name}"] for name in HEADS if name != "uncertain"),
    ["loss=ssim_nll", "model/head=uncertain"],
    ["loss=ssim_l1_distill", "loss.terms.distilled.feature_weight=1.0"],
]


def parts(choice: list[str]) -> tuple[DepthNet, WeightedSum]:
    """A network and a loss of the YAML files."""
    untrained = ["teacher=eldenet_s", 'loss.terms.distilled.teacher.overrides=["model.head.min_depth=0.2"]']
    teacher = untrained if "distill" in str(choice) else []
    settings = compose(TrainSettings, ["model=eldenet_s", *teacher, *choice])
    return instantiate(settings.model, "model"), instantiate(settings.loss, "loss")
