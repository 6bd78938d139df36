"""A trained network, pictures for it, and its meters under torch."""

import numpy as np
import pytest
from support.rooms_network import meters, smooth_pictures, trained

from eldenet.deploy.openvino_export import decline_telemetry
from eldenet.model import DepthNet

decline_telemetry()  # some tests import OpenVINO themselves


@pytest.fixture(scope="session")
def trained_model() -> DepthNet:
    return trained()


@pytest.fixture(scope="session")
def images() -> np.ndarray:
    return smooth_pictures()


@pytest.fixture(scope="session")
def reference(trained_model: DepthNet, images: np.ndarray) -> np.ndarray:
    return meters(trained_model, images)
