"""Every changed bit of an exported file is noticed; damaged and foreign files end in one line."""

import re
from pathlib import Path

import pytest
from support.damages import flips_and_cuts
from support.rooms_network import SIZE

import eldenet
from eldenet.benchmark import BenchmarkSettings, prepare
from eldenet.compose import compose
from eldenet.deploy import runtimes
from eldenet.deploy.benchmarking.measure import Case
from eldenet.deploy.metadata import DIGEST, check_seal, describe, is_whole
from eldenet.deploy.onnx_export import write_onnx
from eldenet.deploy.openvino_export import write_openvino
from eldenet.deploy.runtimes.base import Runtime
from eldenet.export import ExportSettings, target_of
from eldenet.system.onnx_files import read_graph

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


@pytest.fixture(scope="module")
def exported(trained_model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    facts = describe(trained_model, "m", SIZE)
    graph = write_onnx(trained_model, folder / "m.onnx", SIZE, batch=1, metadata=facts)
    write_openvino(graph, folder / "m.xml", facts)
    return folder


@pytest.fixture
def copied(exported: Path, tmp_path: Path) -> Path:
    for file in exported.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


@pytest.mark.parametrize("name", ["m.onnx", "m.xml", "m.bin"])
def test_every_changed_bit_of_an_exported_file_is_noticed(name: str, copied: Path) -> None:
    path = copied / name
    network = path if path.suffix == ".onnx" else copied / "m.xml"
    assert check_seal(network)
    whole = path.read_bytes()
    for content in flips_and_cuts(whole):
        path.write_bytes(content)
        assert not is_whole(network)
    if path.suffix == ".onnx":  # whole but for its metadata
        path.write_bytes(whole[: whole.rindex(b"eldenet.eldenet_version") - 5])
        assert not is_whole(path)
    path.write_bytes(flips_and_cuts(whole)[0])
    for runtime in runtimes.READS[network.suffix]:
        with pytest.raises(ValueError, match=rf"{network} does not match its digest: .*export it again"):
            runtimes.load(network, runtime, threads=1)


def test_a_file_without_its_weights_says_so(copied: Path) -> None:
    (copied / "m.bin").unlink()
    with pytest.raises(ValueError, match=r"m\.xml needs m\.bin, which holds its weights"):
        runtimes.load(copied / "m.xml", threads=1)


@pytest.mark.parametrize("name", ["m.onnx", "m.xml"])
def test_files_without_a_digest_load(name: str, copied: Path) -> None:
    path = copied / name
    if path.suffix == ".onnx":
        graph = read_graph(path)
        graph.producer_name = "pytorch"
        graph.metadata_props.remove(next(entry for entry in graph.metadata_props if DIGEST in entry.key))
        content = graph.SerializeToString()
    else:
        content = re.sub(rb"<digest[^>]*>", b"", path.read_bytes())
    path.write_bytes(content)
    assert not check_seal(path)
    for runtime in runtimes.READS[path.suffix]:
        assert runtimes.load(path, runtime, threads=1).fixed_size == SIZE


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("input_size", value) for value in ("[1e6, 1e6]", "[0, 3]")),
        *(("stretch", value) for value in ("-1", "NaN", "no JSON")),
        *(("canonical_focal", "[1]"), ("params", "true")),
    ],
)
def test_an_odd_figure_in_the_metadata_is_named(name: str, value: str) -> None:
    with pytest.raises(ValueError, match=rf"^m\.onnx is truncated or not a valid exported network.*{name}"):
        Runtime("fp32", 1, "cpu", {name: value}, "m.onnx")


def test_a_name_in_the_weights_cannot_leave_the_folder(
    trained_model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trained_model, "info", {"model_name": "../../ESCAPED"})
    s = ExportSettings("x", size=list(SIZE))
    assert target_of(s, trained_model).output.parent == Path("exports")


@pytest.mark.slow
def test_benchmark_exports_a_cut_file_again(tmp_path: Path) -> None:
    options = ["models=[eldenet_s]", "sizes=[[32,64]]", "reference=eldenet_s", f"output='{tmp_path}'"]
    s = compose(BenchmarkSettings, options)
    case = Case("../m", *SIZE, 1, "openvino", "fp32", 1, "cpu")
    first = prepare(case, eldenet.load("eldenet_s"), "print", s).source
    assert first is not None
    assert first.parent == tmp_path / "exports"  # whatever the name
    weights = first.with_suffix(".bin")
    weights.write_bytes(weights.read_bytes()[:1000])
    assert prepare(case, eldenet.load("eldenet_s"), "print", s).source == first
    assert is_whole(first)
