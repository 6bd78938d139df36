"""Every changed bit of an exported file is noticed; damaged and foreign files end in one line."""

from pathlib import Path

import numpy as np
import pytest
from support.damages import refusal
from support.rooms_network import SIZE

import eldenet
from eldenet.compose import compose_config
from eldenet.config import build_benchmark
from eldenet.deploy import runtimes
from eldenet.deploy.benchmarking.measure import Case
from eldenet.deploy.benchmarking.run import prepare
from eldenet.deploy.exporting import ExportSetup, target_of
from eldenet.deploy.files import checked, describe, read_metadata, set_metadata, write_onnx, write_openvino
from eldenet.deploy.sealing import check_seal, is_whole

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


def damages(content: bytes) -> list[bytes]:
    """Forty changed bits and ten cuts."""
    generator, found = np.random.default_rng(0), []
    for _ in range(40):
        copy = bytearray(content)
        copy[generator.integers(len(copy))] ^= 1 << int(generator.integers(8))
        found.append(bytes(copy))
    return found + [content[:end] for end in generator.integers(0, len(content), 10)]


@pytest.mark.parametrize("name", ["m.onnx", "m.xml", "m.bin"])
def test_every_changed_bit_of_an_exported_file_is_noticed(name: str, copied: Path) -> None:
    path = copied / name
    network = path if path.suffix == ".onnx" else copied / "m.xml"
    assert check_seal(network)
    for content in damages(path.read_bytes()):
        path.write_bytes(content)
        assert not is_whole(network)


def test_a_cut_onnx_file_whose_metadata_alone_is_gone_is_noticed(copied: Path) -> None:
    path = copied / "m.onnx"
    whole = path.read_bytes()
    for end in (whole.rindex(b"eldenet-sha256") - 4, whole.rindex(b"eldenet.units") - 4):
        path.write_bytes(whole[:end])
        assert not is_whole(path)


@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_a_damaged_file_does_not_run(runtime: str, copied: Path) -> None:
    path = copied / ("m.onnx" if runtime == "onnxruntime" else "m.xml")
    weights = path.with_suffix(".onnx" if runtime == "onnxruntime" else ".bin")
    content = bytearray(weights.read_bytes())
    content[len(content) // 2] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=rf"{path} does not match its digest: .*export it again"):
        runtimes.load(path, runtime, threads=1)
    if runtime == "openvino":
        weights.unlink()
        with pytest.raises(ValueError, match=r"m\.xml needs m\.bin, which holds its weights"):
            runtimes.load(path, runtime, threads=1)


def unsealed(path: Path) -> bytes:
    content = path.read_bytes()
    if path.suffix == ".xml":
        return content[: content.rindex(b"<!--")]
    import onnx

    graph = onnx.load(path)
    graph.doc_string = ""
    del graph.metadata_props[-1]
    return graph.SerializeToString()


@pytest.mark.parametrize(
    ("name", "runtime"), [("m.onnx", "onnxruntime"), ("m.onnx", "openvino"), ("m.xml", "openvino")]
)
def test_files_without_a_digest_load_and_cut_ones_end_in_one_error(
    name: str, runtime: str, copied: Path
) -> None:
    path = copied / name
    content = unsealed(path)
    path.write_bytes(content)
    assert not check_seal(path)
    assert runtimes.load(path, runtime, threads=1).fixed_size == SIZE
    for end in np.random.default_rng(2).integers(0, len(content), 10):
        path.write_bytes(content[:end])
        said = refusal(lambda: runtimes.load(path, runtime, threads=1))
        assert said is None or str(path) in said


@pytest.mark.parametrize("size", ['"7"', "[1e6, 1e6]", "[1000000, 1000000]", "[0, 3]", "no JSON", "{}"])
def test_an_odd_size_in_the_metadata_is_named(size: str, copied: Path) -> None:
    path = copied / "m.onnx"
    set_metadata(path, read_metadata(path) | {"input_size": size})
    for runtime in ("onnxruntime", "openvino"):
        with pytest.raises(ValueError, match=rf"{path} is truncated or not a valid exported network"):
            runtimes.load(path, runtime, threads=1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("stretch", value) for value in ('"x"', "-1", "1e999", "NaN", "[" * 100_000, "9" * 400, "no JSON")),
        *(("canonical_focal", "[1]"), ("canonical_width", "0"), ("gmacs", '"x"'), ("params", "true")),
    ],
)
def test_an_odd_figure_in_the_metadata_is_named(name: str, value: str, copied: Path) -> None:
    with pytest.raises(ValueError, match=rf"^{copied} is truncated or not a valid exported network.*{name}"):
        checked(copied, {name: value})


def test_a_name_in_the_weights_cannot_leave_the_folder(
    trained_model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trained_model, "info", {"model_name": "../../ESCAPED"})
    setup = ExportSetup(
        "x", "onnx", "fp32", SIZE, None, 1, 18, None, False, None, 1, 1, None, ()
    )  # fmt: skip
    assert target_of(setup, trained_model).output.parent == Path("exports")


def test_benchmark_exports_a_cut_file_again(tmp_path: Path) -> None:
    options = ["models=[eldenet_s]", "sizes=[[32,64]]", "reference=eldenet_s", f"output='{tmp_path}'"]
    setup = build_benchmark(compose_config("benchmark", options))
    case = Case("../m", *SIZE, 1, "openvino", "fp32", 1, "cpu")
    first = prepare(case, eldenet.load("eldenet_s"), "print", setup).source
    assert first is not None
    assert first.parent == tmp_path / "exports"  # whatever the name
    weights = first.with_suffix(".bin")
    weights.write_bytes(weights.read_bytes()[:1000])
    assert prepare(case, eldenet.load("eldenet_s"), "print", setup).source == first
    assert is_whole(first)


def test_a_file_that_is_no_onnx_file_says_so_once(tmp_path: Path) -> None:
    (tmp_path / "bad.onnx").write_text("garbage")
    with pytest.raises(ValueError, match=r"bad\.onnx is truncated or not a valid ONNX file") as raised:
        eldenet.runtimes.load(tmp_path / "bad.onnx")
    assert str(raised.value).count("bad.onnx") == 1
