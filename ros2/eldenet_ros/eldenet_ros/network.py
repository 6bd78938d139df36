"""The depth network of the nodes. Needs no ROS."""

from eldenet.deploy import runtimes
from eldenet.deploy.predictor import DepthPredictor


def open_predictor(
    checkpoint: str, *, engine: str = "auto", device: str = "cpu", threads: int = 0
) -> DepthPredictor:
    """Load weights of the package, a run folder, or an exported file; with sigma where they know it.

    Args:
        checkpoint: a name of :func:`eldenet.list_weights`, a folder, or an ``.onnx`` or ``.xml`` file.
        engine: as in :func:`eldenet.deploy.runtimes.load`.
        device: as there.
        threads: on a CPU; 0: all cores.

    Raises:
        ValueError: the network cannot run here.
        FileNotFoundError: there is no such file.
    """
    network = runtimes.load(checkpoint, engine, threads=threads or None, device=device)
    return DepthPredictor(network, uncertainty=network.distribution is not None)
