"""Nothing is sent to anybody about the use of OpenVINO and nncf, which report on their own."""

import os
import subprocess
import sys
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path

import pytest

if not all(map(find_spec, ("openvino", "nncf"))) or not list(distributions(name="openvino-telemetry")):
    pytest.skip("needs openvino, nncf and openvino-telemetry", allow_module_level=True)

# what would be sent is counted instead, in a process without pytest, where nncf is silent anyway
COUNTING = """
import sys
import openvino_telemetry.main
sent = []
openvino_telemetry.main.TelemetrySender.send = lambda self, *message: sent.append(message)
"""
HIDDEN = COUNTING + "del sys.modules['openvino_telemetry']\n"
WORK = """
import numpy as np
import onnx
from onnx import TensorProto as T, helper
weight = helper.make_tensor("w", T.FLOAT, (1, 3, 3, 3), np.ones(27))
image = helper.make_tensor_value_info("image", T.FLOAT, (1, 3, 8, 8))
depth = helper.make_tensor_value_info("depth", T.FLOAT, (1, 1, 8, 8))
node = helper.make_node("Conv", ["image", "w"], ["depth"], pads=[1, 1, 1, 1])
graph = helper.make_graph([node], "g", [image], [depth], [weight])
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), "a.onnx")
from eldenet import runtimes
from eldenet.deploy.openvino_export import write_openvino
from eldenet.deploy.openvino_export import quantize_openvino
images = np.ones((1, 3, 8, 8), np.float32)
write_openvino("a.onnx", "a.xml", {})
quantize_openvino("a.onnx", "b.xml", [images], {})
for name in ("a.onnx", "a.xml", "b.xml"):
    assert runtimes.load(name, "openvino", threads=1)(images).shape == (1, 1, 8, 8)
print("sent", len(sent))
"""


# handled on the stack of Python's faulthandler, as in pytest
SIGNALED = """
import faulthandler, signal
faulthandler.enable()
signal.signal(signal.SIGCHLD, lambda *_: None)
"""
SIGNAL = "signal.raise_signal(signal.SIGCHLD)\n"


def sent(code: str, folder: Path) -> int:
    """Return the number of messages of a program whose user never declined anything."""
    environment = {name: value for name, value in os.environ.items() if name != "CI"} | {"HOME": str(folder)}
    shown = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, timeout=300
    )
    assert shown.returncode == 0, shown.stderr
    return int(shown.stdout.splitlines()[-1].removeprefix("sent "))


def test_openvino_reports_its_import_where_nobody_declines(tmp_path: Path) -> None:
    """So that the next test can fail."""
    assert sent(COUNTING + "import openvino\nprint('sent', len(sent))", tmp_path) > 0


@pytest.mark.slow
def test_export_quantization_and_running_send_nothing_and_survive_a_signal(tmp_path: Path) -> None:
    assert sent(HIDDEN + SIGNALED + WORK + SIGNAL, tmp_path) == 0
    assert not (tmp_path / "intel").exists()  # nor is a number kept by which this user could be told apart


@pytest.mark.slow
def test_nothing_more_is_sent_where_the_program_imported_openvino_itself(tmp_path: Path) -> None:
    assert sent(COUNTING + "import openvino\nimport nncf\nsent.clear()\n" + WORK, tmp_path) == 0
