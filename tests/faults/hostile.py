"""Files that a stranger made to run code, to leave their folder, or to fill the memory.

A further one is a function below with ``@hostile``: it writes into a folder and returns what a user would do
with it. Whatever happens, ``folder/ESCAPED`` must not come to be.
"""

import json
import os
import pickle
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from support import layouts
from support.films import write_video
from support.rooms_network import trained
from support.stored_study import figures, record_of, write_plan

from .campaign import RAW, Outcome, in_processes, judge
from .kinds import (
    CAR,
    _checkpoint,
    _kitti_objects,
    _policy,
    _read_kitti_objects,
    _read_model,
    _read_rows,
    _read_video,
    _report,
    _resume,
    _save_weights,
    _tables,
    _train,
    _weights,
    frames,
)

Attack = tuple[Path, Callable[[], Any]]  # the file that a message should name, and what a user does with it
QUICK_WITHOUT = ("checkpoint of", "checkpoint without", "study", "onnx file", "xml")  # they take seconds
HOSTILE: dict[str, Callable[[Path], Attack]] = {}


def hostile(write: Callable[[Path], Attack]) -> Callable[[Path], Attack]:
    """Put a writer into ``HOSTILE`` under its name."""
    HOSTILE[write.__name__.strip("_").replace("_", " ")] = write
    return write


def refused(folder: Path, file: Path, use: Callable[[], Any]) -> Attack:
    """An attack that has reached its goal once ``use`` returns."""

    def and_tell() -> None:
        use()
        (folder / "ESCAPED").touch()

    return file, and_tell


def attack_all(folder: Path, *, quick: bool) -> dict[str, Outcome]:
    """Outcome of each hostile file; one that reached its goal is raw, whatever was said."""

    def one(name: str) -> Outcome:
        place = folder / name.replace(" ", "_") / "inside"
        place.mkdir(parents=True)
        file, use = HOSTILE[name](place)
        found = judge(use, (file.name, file.stem, place.name, "refused"), None)
        escaped = [path for path in place.parent.rglob("*ESCAPED*") if path.is_file()]
        return Outcome(RAW, f"reached its goal; {found.said}") if escaped else found

    names = [name for name in HOSTILE if not (quick and any(word in name for word in QUICK_WITHOUT))]
    return dict(zip(names, in_processes([partial(one, name) for name in names]), strict=True))


class _Touch:
    """Unpickled, it writes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.system, (f"touch '{self.path}'",)


def _image(path: Path) -> Attack:
    from eldenet.data.io import read_image

    return path, lambda: read_image(path)


def _depth(path: Path, encoding: str = "meters") -> Attack:
    from eldenet.data.io import read_depth

    return path, lambda: read_depth(path, encoding)


# --- programs -----------------------------------------------------------------------------------------------


@hostile
def a_pickle_as_checkpoint(folder: Path) -> Attack:
    file = folder / "last.pt"
    file.write_bytes(pickle.dumps(_Touch(folder / "ESCAPED")))
    return file, lambda: _checkpoint(file)


@hostile
def a_pickle_as_weights(folder: Path) -> Attack:
    file = folder / "start.pt"
    file.write_bytes(pickle.dumps({"weight": _Touch(folder / "ESCAPED")}))
    return file, lambda: _weights(file)


@hostile
def a_pickle_in_an_npy_file(folder: Path) -> Attack:
    file = folder / "depth.npy"
    np.save(file, np.array([_Touch(folder / "ESCAPED")], dtype=object), allow_pickle=True)
    return _depth(file)


def _model_with(folder: Path, change: Callable[[dict[str, Any]], None]) -> Attack:
    trained().save_pretrained(folder / "model")
    file = folder / "model/config.json"
    config = json.loads(file.read_text())
    change(config)
    file.write_text(json.dumps(config))
    return file, lambda: _read_model(folder)


@hostile
def a_model_that_names_os_system(folder: Path) -> Attack:
    call = {"_target_": "os.system", "command": f"touch '{folder / 'ESCAPED'}'"}
    return _model_with(folder, lambda config: config["model"].update(head=call))


@hostile
def a_model_that_fetches_weights(folder: Path) -> Attack:
    def change(config: dict[str, Any]) -> None:
        config["model"]["network"]["backbone"]["pretrained"] = "/etc/passwd"

    return _model_with(folder, change)


@hostile
def a_policy_with_a_foreign_observer(folder: Path) -> Attack:
    from safetensors.torch import load_file, save_file

    file = folder / "policy.safetensors"
    from eldenet.navigation.policy_files import DEFAULT_WEIGHTS

    notes = {"inputs": 10**9, "actions": 10**9, "hidden": [10**9], "observer": {"shell": "ls"}, "info": {}}
    save_file(load_file(DEFAULT_WEIGHTS), str(file), metadata={"navigator": json.dumps(notes)})
    return file, lambda: _policy(file)


# --- ways out of the folder ---------------------------------------------------------------------------------


def _folder_data(root: Path) -> Attack:
    from eldenet.data.folder import FolderDataset

    def read() -> Any:
        data = FolderDataset(root, csv="pairs.csv", max_depth=10.0)
        return [data[index] for index in range(len(data))]

    return root / "pairs.csv", read


def _outside(folder: Path, line: str) -> Attack:
    layouts.folder(folder / "data", count=1)
    layouts.folder(folder / "secret", count=1)
    (folder / "data/pairs.csv").write_text(line)
    return refused(folder, *_folder_data(folder / "data"))


@hostile
def a_list_that_climbs_out(folder: Path) -> Attack:
    return _outside(folder, "../secret/images/f000.png,../secret/depths/f000.png\n")


@hostile
def a_list_of_absolute_paths(folder: Path) -> Attack:
    return _outside(folder, f"{folder}/secret/images/f000.png,{folder}/secret/depths/f000.png\n")


@hostile
def hdf5_that_links_to_another_file(folder: Path) -> Attack:
    import h5py

    layouts.hdf5(folder)
    with h5py.File(folder / "secret.h5", "w") as secret:
        secret["rgb"], secret["depth"] = layouts.SMALL.rgb.transpose(2, 0, 1), layouts.SMALL.meters
    file = folder / "train/office_0002/00001.h5"
    with h5py.File(file, "w") as damaged:
        for key in ("rgb", "depth"):
            damaged[key] = h5py.ExternalLink(str(folder / "secret.h5"), key)
    return refused(folder, file, lambda: frames(folder, "hdf5"))


@hostile
def hdf5_with_pixels_in_another_file(folder: Path) -> Attack:
    import h5py

    layouts.hdf5(folder)
    rgb = layouts.SMALL.rgb.transpose(2, 0, 1)
    (folder / "secret.bin").write_bytes(bytes(rgb.size))
    file = folder / "train/office_0002/00001.h5"
    with h5py.File(file, "w") as damaged:
        damaged.create_dataset("rgb", rgb.shape, "u1", external=[(folder / "secret.bin", 0, rgb.size)])
        damaged["depth"] = layouts.SMALL.meters
    return refused(folder, file, lambda: frames(folder, "hdf5"))


@hostile
def onnx_with_weights_in_another_file(folder: Path) -> Attack:
    import onnx

    from eldenet.deploy import runtimes

    (folder / "secret").write_bytes(bytes(64))
    inside = folder / "exports"
    inside.mkdir()
    tensor = onnx.TensorProto(name="w", data_type=1, dims=[16], data_location=1)
    for key, value in (("location", "../secret"), ("offset", "0"), ("length", "64")):
        tensor.external_data.add(key=key, value=value)
    make = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Add", ["image", "w"], ["depth"])],
        "g", [make("image", 1, [16])], [make("depth", 1, [16])], [tensor],
    )  # fmt: skip
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8)
    (inside / "net.onnx").write_bytes(model.SerializeToString())
    return inside / "net.onnx", lambda: runtimes.load(inside / "net.onnx", "onnxruntime", threads=1)


def _playlist(folder: Path, text: str) -> Attack:
    from eldenet.deploy.video_files import is_video_file

    secret = write_video(folder / "secret.mkv")
    file = folder / "walk.mp4"
    file.write_text(text.replace("VIDEO", str(secret)))
    return refused(folder, file, lambda: _read_video(file) if is_video_file(file) else None)


@hostile
def a_playlist_as_video(folder: Path) -> Attack:
    return _playlist(folder, "ffconcat version 1.0\nfile VIDEO\n")


HLS = "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nVIDEO\n#EXT-X-ENDLIST\n"
SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\n"


@hostile
def a_playlist_of_hls_as_video(folder: Path) -> Attack:
    return _playlist(folder, HLS)


@hostile
def an_address_as_video(folder: Path) -> Attack:
    return _playlist(folder, SDP)


# --- bombs --------------------------------------------------------------------------------------------------


@hostile
def a_pgm_of_spaces(folder: Path) -> Attack:
    (folder / "picture.pgm").write_bytes(b"P5" + b" " * 40)
    return _image(folder / "picture.pgm")


@hostile
def a_png_of_900_million_pixels(folder: Path) -> Attack:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    row = zlib.compressobj(1)  # 9 takes longer than an attack may, on a busy machine
    side = 30000
    data = b"".join(row.compress(bytes(side + 1)) for _ in range(side)) + row.flush()
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    file = folder / "picture.png"
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    return refused(folder, *_image(file))


@hostile
def a_pfm_of_a_billion_rows(folder: Path) -> Attack:
    (folder / "depth.pfm").write_bytes(b"Pf\n999999999 999999999\n-1.0\n")
    return _depth(folder / "depth.pfm")


@hostile
def an_npy_file_of_a_terabyte(folder: Path) -> Attack:
    file = folder / "depth.npy"
    np.save(file, np.zeros((2, 2), np.float32))
    file.write_bytes(file.read_bytes().replace(b"(2, 2)", b"(1000000, 1000000)", 1))
    return _depth(file)


@hostile
def hdf5_of_a_terabyte(folder: Path) -> Attack:
    import h5py

    layouts.hdf5(folder)
    file = folder / "train/office_0002/00001.h5"
    with h5py.File(file, "w") as damaged:
        damaged.create_dataset("rgb", (3, 600000, 600000), "u1", chunks=(1, 1000, 1000), compression="gzip")
        damaged.create_dataset("depth", (600000, 600000), "f4", chunks=(1000, 1000), compression="gzip")
    return file, lambda: frames(folder, "hdf5")


@hostile
def json_nested_without_end(folder: Path) -> Attack:
    (folder / "run.json").write_text("[" * 200000 + "]" * 200000)
    return folder / "run.json", lambda: _report(folder)


@hostile
def json_of_a_huge_number(folder: Path) -> Attack:
    return _changed_run(folder, lambda run: run["metrics"].update(rmse="HUGE"), ('"HUGE"', "1" + "0" * 400))


@hostile
def safetensors_of_a_huge_header(folder: Path) -> Attack:
    file = folder / "start.safetensors"
    _save_weights(file)
    file.write_bytes(struct.pack("<Q", 1 << 60) + file.read_bytes()[8:])
    return file, lambda: _weights(file)


@hostile
def an_xml_of_a_billion_laughs(folder: Path) -> Attack:
    from eldenet.deploy import runtimes

    entities = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 12))
    file = folder / "net.xml"
    file.write_text(f'<?xml version="1.0"?><!DOCTYPE net [<!ENTITY l0 "lol">{entities}]><net>&l11;</net>')
    (folder / "net.bin").write_bytes(b"")
    return file, lambda: runtimes.load(file, "openvino", threads=1)


def _state(folder: Path, state: dict[str, Any]) -> Attack:
    import torch

    file = folder / "start.pt"
    torch.save(state, file)
    return refused(folder, file, lambda: _weights(file))


@hostile
def weights_of_one_number_for_7_gb(folder: Path) -> Attack:
    import torch

    return _state(folder, {"weight": torch.zeros(1).expand(2_000_000_000)})


@hostile
def weights_of_a_shape_of_2_to_the_40(folder: Path) -> Attack:
    import torch

    file, use = _state(folder, {"weight": torch.zeros(0x1234)})
    with zipfile.ZipFile(file) as whole:
        entries = {entry: whole.read(entry) for entry in whole.namelist()}
    with zipfile.ZipFile(file, "w") as damaged:
        for entry, content in entries.items():
            large = b"\x8a\x06" + (1 << 40).to_bytes(6, "little")
            damaged.writestr(entry, content.replace(b"M\x34\x12\x85", large + b"\x85"))
    return file, use


@hostile
def weights_without_numbers(folder: Path) -> Attack:
    import torch

    return _state(folder, {"weight": torch.zeros(1 << 40, device="meta")})


@hostile
def sparse_weights(folder: Path) -> Attack:
    import torch

    return _state(folder, {"weight": torch.sparse_coo_tensor([[0]], [1.0], (1 << 40,))})


@hostile
def deflated_weights(folder: Path) -> Attack:
    import torch

    file, use = _state(folder, {"weight": torch.zeros(1000)})
    with zipfile.ZipFile(file) as whole:
        entries = {entry: whole.read(entry) for entry in whole.namelist()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as damaged:
        for entry, content in entries.items():
            damaged.writestr(entry, content)
    return file, use


@hostile
def a_bytearray_of_64_gigabytes(folder: Path) -> Attack:
    file, use = _state(folder, {})
    with zipfile.ZipFile(file) as whole:
        entries = {entry: whole.read(entry) for entry in whole.namelist()}
    pickled = b"\x80\x02}X\1\0\0\0acbuiltins\nbytearray\n\x8a\x05\0\0\0\0\x10\x85Rs."
    with zipfile.ZipFile(file, "w") as damaged:
        for entry, content in entries.items():
            damaged.writestr(entry, pickled if entry.endswith("data.pkl") else content)
    return file, use


@hostile
def a_webp_of_34_bytes_and_268_million_pixels(folder: Path) -> Attack:
    file = folder / "picture.webp"
    bits = struct.pack("<I", 0x3FFF - 1 | (0x3FFF - 1) << 14)
    file.write_bytes(
        b"RIFF" + struct.pack("<I", 26) + b"WEBPVP8L" + struct.pack("<I", 14) + b"/" + bits + bytes(9)
    )
    return _image(file)


@hostile
def a_tiff_of_60_samples_per_pixel(folder: Path) -> Attack:
    from PIL import Image

    file = folder / "picture.tif"
    Image.new("RGB", (16, 16)).save(file)
    content = bytearray(file.read_bytes())
    for tag, value in ((256, 9000), (257, 9000), (277, 60)):
        at = content.index(struct.pack("<H", tag), 8)
        struct.pack_into("<HHII", content, at, tag, 4, 1, value)
    file.write_bytes(content)
    return _image(file)


@hostile
def an_exr_of_60_channels(folder: Path) -> Attack:
    import OpenEXR

    file = folder / "depth.exr"
    layers = {f"c{number:02d}": np.zeros((8, 8), np.float32) for number in range(60)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, layers).write(str(file))
    return _depth(file)


@hostile
def a_split_of_5_gb_in_a_mat_file(folder: Path) -> Attack:
    from scipy.io import savemat

    from eldenet.data.nyu_hdf5 import _split_numbers

    file = folder / "splits.mat"
    savemat(file, {"trainNdxs": np.zeros((2000, 2000)), "testNdxs": np.ones(3)}, do_compression=True)
    return refused(folder, file, lambda: _split_numbers(file, "train"))


@hostile
def hdf5_of_millions_of_unwritten_chunks(folder: Path) -> Attack:
    import h5py

    layouts.hdf5(folder)
    file = folder / "train/office_0002/00001.h5"
    with h5py.File(file, "w") as damaged:
        damaged.create_dataset("rgb", (3, 4000, 4000), "u1", chunks=(1, 1, 1))
        damaged.create_dataset("depth", (4000, 4000), "f4", chunks=(1, 1))
    return refused(folder, file, lambda: frames(folder, "hdf5"))


@hostile
def hdf5_of_one_chunk_of_4_gb(folder: Path) -> Attack:
    import h5py

    layouts.hdf5(folder)
    file = folder / "train/office_0002/00001.h5"
    with h5py.File(file, "w") as damaged:
        large = (3, 10000, 60000)
        damaged.create_dataset("rgb", (3, 8, 8), "u1", chunks=large, maxshape=large, compression="gzip")
        damaged["depth"] = np.ones((8, 8), np.float32)
    return refused(folder, file, lambda: frames(folder, "hdf5"))


# --- figures and words --------------------------------------------------------------------------------------


def _changed_run(
    folder: Path, change: Callable[[dict[str, Any]], object], text: tuple[str, str] = ("", "")
) -> Attack:
    run = record_of(write_plan(folder), "small", 0, figures(0.0, 0))
    file = folder / "run.json"
    change(run)
    file.write_text(json.dumps(run).replace(*text) if text[0] else json.dumps(run))
    return file, lambda: _report(folder)


@hostile
def a_delta1_of_7(folder: Path) -> Attack:
    return refused(folder, *_changed_run(folder, lambda run: run["metrics"].update(delta1=7.0)))


@hostile
def an_rmse_of_minus_5(folder: Path) -> Attack:
    return refused(folder, *_changed_run(folder, lambda run: run["metrics"].update(rmse=-5.0)))


@hostile
def an_rmse_in_words(folder: Path) -> Attack:
    return _changed_run(folder, lambda run: run["metrics"].update(rmse="=cmd|' /C calc'!A0"))


@hostile
def a_record_of_lists(folder: Path) -> Attack:
    return _changed_run(folder, lambda run: run.update(cost=[], protocol=[], config=[]))


@hostile
def latex_html_and_formulas_in_a_name(folder: Path) -> Attack:
    name = "\\immediate\\write18{ls}<script>alert(1)</script>=cmd|x\n| a | b |"
    file, _ = _changed_run(folder, lambda run: run.update(model=name))

    def report() -> None:
        from eldenet.results.tables import to_latex, to_markdown

        titles, rows = _report(folder)
        latex = re.sub("(?m)^%.*", "", to_latex(titles, rows, [name]))  # without comments
        markdown = to_markdown(titles, rows, [name])
        if "\\immediate" in latex or re.search(r"(?<!\\)<script|^\| a \| b", markdown, re.M):
            (folder / "ESCAPED").touch()

    return file, report


@hostile
def odd_sizes_in_the_metadata_of_an_onnx_file(folder: Path) -> Attack:
    from eldenet.deploy import runtimes
    from eldenet.deploy.onnx_export import write_onnx

    odd = {"input_size": '"7"', "camera_size": "[1e6, 1e6]"}
    file = write_onnx(trained(), folder / "net.onnx", (32, 64), batch=1, opset=17, metadata=odd)
    return file, lambda: runtimes.load(file, "onnxruntime", threads=1).info


@hostile
def a_checkpoint_without_identity(folder: Path) -> Attack:
    import torch

    _train(folder)
    file = folder / "checkpoints/last.pt"
    state = torch.load(file)
    del state["identity"]
    torch.save(state, file)
    return file, lambda: _resume(folder)


@hostile
def a_checkpoint_of_epoch_a_billion(folder: Path) -> Attack:
    import torch

    _train(folder)
    file = folder / "checkpoints/last.pt"
    state = torch.load(file)
    state["progress"] |= {"epoch": 10**9, "batch": 10**9}
    torch.save(state, file)
    return refused(folder, file, lambda: _resume(folder))


@hostile
def a_policy_that_is_not_a_number(folder: Path) -> Attack:
    from safetensors import safe_open
    from safetensors.torch import save_file

    from eldenet.navigation.policy_files import DEFAULT_WEIGHTS

    file = folder / "policy.safetensors"
    with safe_open(str(DEFAULT_WEIGHTS), framework="pt") as packaged:
        weights = {name: packaged.get_tensor(name) * float("nan") for name in packaged.keys()}  # noqa: SIM118
        save_file(weights, str(file), metadata=packaged.metadata())
    return refused(folder, file, lambda: _policy(file))


@hostile
def labels_that_are_not_numbers(folder: Path) -> Attack:
    _kitti_objects(folder)
    file = folder / "label_2/000007.txt"
    file.write_text(CAR.replace("13.22", "nan"))
    return refused(folder, file, lambda: _read_kitti_objects(folder))


@hostile
def old_rows_without_a_key(folder: Path) -> Attack:
    file = folder / "rows.jsonl"
    file.write_text('{"model": "net"}\n[1, 2]\n7\n{"key": {"a": 1}}\n{"key": [[1], {}]}\n')
    return file, lambda: _read_rows(file)


@hostile
def a_study_of_damaged_records(folder: Path) -> Attack:
    from eldenet.results.packed_runs import add_record

    study = write_plan(folder, "seeds: [0, 1, 2]", "seeds: [0]")
    add_record(folder, "small/seed0", {"metrics": {"delta1": None}, "seed": "none", "config": 3})
    return folder / "runs.jsonl.xz", lambda: _tables(study.folder)
