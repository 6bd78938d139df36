"""Every kind of file that eldenet reads: how a small whole one is made, and how a user's command reads it."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from support import layouts
from support.damaged_layouts import LAYOUTS
from support.damages import write as write_picture
from support.detector_files import FILES, FRAME
from support.detector_files import save as save_detector
from support.films import write_video
from support.rooms_network import SIZE, smooth_pictures, trained
from support.stored_study import figures, record_of, settings_of, store, write_plan
from support.training import fit, make_trainer

from .campaign import FileKind

#: They take seconds to write or to read.
COSTLY = ("last.pt", "best.pt", "dqn.pt", "ONNX", "OpenVINO", "runs.jsonl.xz")

layouts.KITTI_SIZES = {"2011_09_26": (60, 80), "2011_09_28": (56, 84)}  # pictures that are read in no time


def one_file(
    name: str,
    file: str,
    write: Callable[[Path], object],
    read: Callable[[Path], Any],
    *,
    digest: bool = False,
    named: tuple[str, ...] = (),
) -> FileKind:
    """A kind whose file stands alone: ``write`` and ``read`` get its path."""

    def write_it(root: Path) -> None:
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        write(root / file)

    return FileKind(name, file, write_it, lambda root: read(root / file), digest, named)


# --- data sets ----------------------------------------------------------------------------------------------


@cache
def _config(layout: str, root: Path) -> Any:
    from eldenet.compose import compose
    from eldenet.train import TrainSettings

    given = [f"data={LAYOUTS[layout].data}", "protocol=folder", "data.input_size=[24,32]"]
    return compose(TrainSettings, given + [text.format(root=root) for text in LAYOUTS[layout].overrides])


def frames(root: Path, layout: str) -> list[Any]:
    """All frames of a data set, as a training gets them and as they are on disk."""
    from eldenet.evaluation.splits import chosen_protocol, open_split

    config, split = _config(layout, root), LAYOUTS[layout].split
    data = open_split(config.data, split, chosen_protocol(config.data, config.protocol))
    return [(data[index], data.load_frame(index)) for index in range(len(data))]  # with every pixel, too


def of_data_set(
    name: str, layout: str, target: int = 0, *, digest: bool = False, named: tuple[str, ...] = ()
) -> FileKind:
    """A file of one of the layouts that ``support.damaged_layouts`` writes."""
    file = LAYOUTS[layout].targets[target]
    return FileKind(
        name,
        file.file,
        LAYOUTS[layout].write,
        partial(frames, layout=layout),
        digest,
        (*(file.named or Path(file.file).stem).split("|"), *named),
    )


DATA = (
    of_data_set("JPEG picture", "densedepth", 0),
    of_data_set("PNG depth, 8 bits", "densedepth", 1, digest=True),
    of_data_set("PNG depth, 16 bits", "folder", 1, digest=True),
    of_data_set("PNG picture", "folder", 0, digest=True),
    of_data_set("TIFF depth", "folder_tiff"),
    of_data_set("OpenEXR depth", "folder_exr"),
    of_data_set("PFM depth", "folder_pfm"),
    of_data_set("npy depth", "folder_npy"),
    of_data_set("npy picture (MTAN)", "mtan"),
    of_data_set("HDF5 frame", "hdf5"),
    of_data_set("MATLAB file of frames", "mat", 0),
    of_data_set("MATLAB file of splits", "mat", 1),
    of_data_set("CSV list of frames", "folder_csv", named=("files are missing",)),
    of_data_set("NYU's list of frames", "sync_list", named=("files are missing",)),
    of_data_set("KITTI's list of frames", "kitti_list", named=("files are missing",)),
    of_data_set("KITTI's calib_cam_to_cam.txt", "kitti", 2),
    of_data_set("KITTI's calib_velo_to_cam.txt", "kitti_raw", 2),
    of_data_set("KITTI's velodyne scan", "kitti_raw", 0),
    of_data_set("KITTI's intrinsics", "kitti_selection", 0),
    of_data_set("Cityscapes' camera.json", "cityscapes", 2),
)


def _picture_kind(ending: str) -> FileKind:
    from eldenet.data.io import read_image

    def write(path: Path) -> None:
        write_picture(path, layouts.SMALL.eight if ending == ".pgm" else layouts.SMALL.rgb)

    return one_file(f"{ending[1:].upper()} picture", f"picture{ending}", write, read_image)


def _store(path: Path) -> Any:
    from eldenet.data.frame_store import FrameStore, slot_size

    frame = layouts.SMALL
    return FrameStore(path, 2, slot_size(frame.rgb.nbytes + frame.meters.nbytes))


def _write_store(path: Path) -> None:
    from eldenet.data.frame_store import make_stamp
    from eldenet.types import Frame

    store = _store(path)
    for index in range(2):
        frame = Frame(layouts.SMALL.rgb, layouts.SMALL.meters + index, None, f"f{index}")
        store.put(index, make_stamp(frame.name), frame)


def _read_store(path: Path) -> Any:
    """What a slot holds; the frame's own files where it holds nothing whole."""
    from eldenet.data.frame_store import make_stamp

    store = _store(path)
    found = [store.get(index, make_stamp(f"f{index}"), f"f{index}") for index in range(2)]
    return [
        (layouts.SMALL.rgb, layouts.SMALL.meters + index) if frame is None else (frame.image, frame.depth)
        for index, frame in enumerate(found)
    ]


CAR = "Car 0.00 0 -1.57 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 -1.62\n"


def _kitti_objects(root: Path) -> None:
    layouts.picture(root / "image_2/000007.png", np.zeros((100, 200, 3), np.uint8))
    for folder in ("calib", "label_2", "velodyne"):
        (root / folder).mkdir()
    (root / "label_2/000007.txt").write_text(CAR + CAR.replace("Car", "Pedestrian"))
    (root / "calib/000007.txt").write_text(
        "P2: 100 0 100 0 0 100 50 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    )
    points = np.random.default_rng(0).uniform((2, -5, -2, 0), (40, 5, 1, 1), (400, 4))
    points.astype(np.float32).tofile(root / "velodyne/000007.bin")


def _read_kitti_objects(root: Path) -> Any:
    from eldenet.perception.kitti_object import KittiObjects

    kitti = KittiObjects(root)
    return [
        (kitti.image(name), kitti.camera(name), kitti.labels(name), kitti.lidar_depth(name, (100, 200)))
        for name in kitti.names
    ]


def _of_kitti_objects(name: str, file: str) -> FileKind:
    return FileKind(name, file, _kitti_objects, _read_kitti_objects)


def _read_video(path: Path) -> Any:
    """As ``predict`` does, which says in the end what is wrong."""
    from eldenet.deploy.video_files import VideoFile

    video = VideoFile(path)
    found = list(video.frames())
    reason = video.why_incomplete(len(found)) or ("" if found else "holds no frame that can be read")
    if reason:
        raise ValueError(f"{path} {reason}")
    return found


DATA += (
    *map(_picture_kind, (".bmp", ".ppm", ".pgm")),
    one_file("frame cache", "frames.bin", _write_store, _read_store, digest=True),
    _of_kitti_objects("KITTI object labels", "label_2/000007.txt"),
    _of_kitti_objects("KITTI object calibration", "calib/000007.txt"),
    _of_kitti_objects("KITTI object scan", "velodyne/000007.bin"),
    *(
        one_file(f"{ending[1:]} video", f"walk{ending}", partial(write_video, frames=8), _read_video)
        for ending in (".mp4", ".mkv", ".avi")
    ),
)


# --- networks -----------------------------------------------------------------------------------------------


def _saved_model(root: Path) -> None:
    trained().save_pretrained(root / "model")


def _read_model(root: Path) -> Any:
    import eldenet

    model = eldenet.load(root / "model")
    with torch.inference_mode():
        return model(torch.from_numpy(smooth_pictures()[:1])), model.state_dict(), model.info


def _train(root: Path, epochs: int = 2) -> None:
    fit(root, trainer=make_trainer(epochs=epochs, checkpoint_every=1), frames=4, val_frames=2)


def _resume(root: Path) -> Any:
    """The model after one more epoch."""
    fit(
        root,
        trainer=make_trainer(epochs=2, checkpoint_every=1),
        frames=4,
        val_frames=2,
        ckpt_path=root,
    )
    return _weights(root / "model/model.safetensors"), _checkpoint(root / "checkpoints/last.pt")


def _checkpoint(path: Path) -> Any:
    from eldenet.training.checkpoint import load_checkpoint

    state = load_checkpoint(path)
    return {name: value for name, value in state.items() if name != "progress"}  # which holds seconds


def _weights(path: Path) -> Any:
    from eldenet.backbones.weights import read_weights

    return read_weights(path)


def _save_weights(path: Path) -> None:
    from safetensors.torch import save_file

    state = {name: value.contiguous() for name, value in trained().state_dict().items()}
    save_file(state, path) if path.suffix == ".safetensors" else torch.save(state, path)


def _exported(root: Path) -> None:
    """An ONNX file and OpenVINO's two; they are made once for all kinds that read them."""
    from eldenet.deploy.metadata import describe
    from eldenet.deploy.onnx_export import write_onnx
    from eldenet.deploy.openvino_export import write_openvino

    shared = root.parent.parent / "exported"
    if not shared.is_dir():
        model = trained()
        notes = describe(model, "small", SIZE)
        write_onnx(model, shared / "net.onnx", SIZE, batch=1, opset=17, metadata=notes)
        write_openvino(shared / "net.onnx", shared / "net.xml", notes)
    shutil.copytree(shared, root, dirs_exist_ok=True)


def _run(root: Path, file: str, runtime: str) -> Any:
    from eldenet.deploy import runtimes

    network = runtimes.load(root / file, runtime, threads=1)
    return network(smooth_pictures()[:1]), network.metadata, network.info


def _of_export(name: str, file: str, runtime: str, read: str | None = None) -> FileKind:
    reader = partial(_run, file=read or file, runtime=runtime)
    return FileKind(name, file, _exported, reader, digest=True, named=("net.xml", "net.bin"))


def _write_detector(path: Path) -> None:
    output, metadata = FILES["yolov8"]
    save_detector(path, output, metadata)


def _detect(path: Path) -> Any:
    from eldenet.perception.onnx_detector import OnnxDetector

    return OnnxDetector(path)(FRAME)


@cache
def _learner() -> Any:
    from eldenet.navigation.dqn import DQN, DQNSettings
    from eldenet.navigation.env import ArenaNavVectorEnv
    from eldenet.navigation.tasks import TrainingArenas

    settings = DQNSettings(
        total_timesteps=600, learning_starts=100, batch_size=16, buffer_size=200, hidden=(16,), seed=0
    )
    return DQN(ArenaNavVectorEnv(4, arenas=TrainingArenas((0, 5))), settings)


def _restored(path: Path) -> Any:
    learner = _learner()
    learner.restore(path)
    parts = (learner.policy_dqn, learner.target_dqn, learner.optimizer, learner.replay)
    return [part.state_dict() for part in parts], learner.num_timesteps, learner.updates


def _write_policy(path: Path) -> None:
    from eldenet.navigation.policy import Navigator

    Navigator.load().save(path)


def _policy(path: Path) -> Any:
    from eldenet.navigation.policy import Navigator

    navigator = Navigator.load(path)
    return navigator.network.state_dict(), navigator.observer.options, navigator.info


def _write_errors(path: Path) -> None:
    from eldenet.navigation.range_errors import RangeErrors

    RangeErrors(
        (0.3, 1.0, 10.0), bias=(0.1, 0.1), spread=(0.1, 0.1), miss=(0.1, 0.1), scale=0.5,
        smooth=0.7, column=0.6, memory=0.7, far=(-0.2, 0.1),
    ).write(path)  # fmt: skip


def _read_errors(path: Path) -> Any:
    from eldenet.navigation.range_errors import RangeErrors

    return RangeErrors.read(path)


NETWORKS = (
    FileKind("model.safetensors", "model/model.safetensors", _saved_model, _read_model, digest=True),
    FileKind("config.json of a model", "model/config.json", _saved_model, _read_model, digest=True),
    FileKind("last.pt", "checkpoints/last.pt", lambda root: _train(root, 2), _resume, digest=True),
    one_file(
        "best.pt",
        "checkpoints/best.pt",
        lambda path: _train(path.parents[1]),
        _checkpoint,
        digest=True,
    ),
    one_file("start weights, .pt", "start.pt", _save_weights, _weights),
    one_file("start weights, .safetensors", "start.safetensors", _save_weights, _weights),
    _of_export("ONNX under ONNX Runtime", "net.onnx", "onnxruntime"),
    _of_export("ONNX under OpenVINO", "net.onnx", "openvino"),
    _of_export("OpenVINO .xml", "net.xml", "openvino"),
    _of_export("OpenVINO .bin", "net.bin", "openvino", "net.xml"),
    one_file("detector, ONNX", "detector.onnx", _write_detector, _detect),
    one_file("policy.safetensors", "policy.safetensors", _write_policy, _policy, digest=True),
    one_file("dqn.pt", "dqn.pt", lambda path: _learner().save(path), _restored, digest=True),
    one_file("range errors of a camera", "errors.json", _write_errors, _read_errors),
)


# --- runs and studies ---------------------------------------------------------------------------------------


def _study(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    study = write_plan(root, "seeds: [0, 1, 2]", "seeds: [0]")
    for name, offset in (("small", 0.0), ("large", 0.05)):
        for seed in study.rows[0].seeds:
            store(study, name, seed, figures(offset, seed))


def _tables(root: Path) -> Any:
    """The tables of a study."""
    from eldenet.studies.plan import read_study
    from eldenet.studies.tables import build_blocks

    return [(block.titles, block.rows, block.notes) for block in build_blocks(read_study(root))]


def _plan(root: Path) -> Any:
    from eldenet.studies.plan import read_study

    study = read_study(root)
    return study.rows, study.overrides, study.reference, study.columns, study.epoch, study.plots


def _report(root: Path) -> Any:
    from eldenet.results.report_table import NEEDED_FOR_COSTS, find_runs, table_of

    return table_of(find_runs([str(root)], NEEDED_FOR_COSTS), ("rmse", "delta1"))


def _one_run(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    record = record_of(write_plan(root), "small", 0, figures(0.0, 0))
    (root / "run.json").write_text(json.dumps(record))


ROW = {
    **{"model": "net", "runtime": "torch", "precision": "fp32", "device": "cpu", "processor": "some"},
    **{"height": 32, "width": 64, "batch": 1, "params": 100, "gmacs": 1.0, "versions": {"torch": "2"}},
    **{"latency_ms_p50": 1.25, "latency_ms_p95": 1.5, "failed": None, "command": "bench", "date": "today"},
    **dict.fromkeys(("gflops", "fps", "throughput_img_s", "peak_memory_mb", "file_mb"), 2.0),
    **dict.fromkeys(("gflops_per_s", "share_of_peak", "ratio_latency"), 0.5),
}


def _write_rows(path: Path) -> None:
    from eldenet.deploy.benchmarking.rows import append_rows

    append_rows(path.parent, [ROW | {"key": ["net", threads], "threads": threads} for threads in (1, 2, 4)])


def _read_rows(path: Path) -> Any:
    from eldenet.deploy.benchmarking.rows import read_rows

    return read_rows(path.parent)


def _write_expected(path: Path) -> None:
    path.write_text(
        "row,block,status,abs_rel,rmse,delta1,protocol,source\nsmall,scratch,,,0.5,0.9,NYU,paper\n"
    )


def _read_expected(path: Path) -> Any:
    from eldenet.studies.tables import read_expected

    return read_expected(path.parent)


def _write_latencies(root: Path) -> None:
    from eldenet.studies.latency import COLUMNS, FACTS

    root.mkdir(parents=True, exist_ok=True)
    study = write_plan(root, "columns:", "latency: benchmark.csv\ncolumns:")
    model = json.dumps(settings_of(study.overrides_of(study.rows[0]), "small")["model"])
    with (root / "benchmark.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["row", "latency_ms_p50", *COLUMNS, *FACTS, "network"])
        facts = ["torch", "fp32", 1, "cpu", 1, 96, 128, 100, 1.0, "some", "torch 2", "2026-01-01", "bench"]
        writer.writerow(["small", 7.5, *facts, model])


def _read_latencies(root: Path) -> Any:

    from eldenet.studies.latency import Latencies
    from eldenet.studies.plan import read_study

    found = Latencies.read(read_study(root))
    assert found is not None
    return found.of("small"), found.title, found.line, found.lines["small"]["network"]


@cache
def _setup(root: Path) -> Any:

    from eldenet.compose import compose
    from eldenet.train import TrainSettings

    return compose(TrainSettings, ["model_name=small", f"output='{root}'", "ckpt_path=auto"])


def _begun_run(root: Path) -> None:
    """The settings of a run in ``work``."""
    from eldenet.system.files import write_yaml

    (root / "checkpoints").mkdir(parents=True)
    (root / "checkpoints/last.pt").touch()
    write_yaml(root / "config.yaml", asdict(_setup(root.parent / "work")))


def _go_on(root: Path) -> Any:
    from eldenet.training.resume import checkpoint_to_resume

    s = _setup(root)
    return checkpoint_to_resume(Path(s.output), s.ckpt_path, asdict(s))


def _normalization(path: Path) -> Any:
    from eldenet.training.normalization import normalization

    return normalization("dataset", None, resumed=path.parent)  # type: ignore[arg-type]


def _write_normalization(path: Path) -> None:
    path.write_text(json.dumps({"mean": [0.5, 0.4, 0.3], "std": [0.2, 0.25, 0.3]}))


RESULTS = (
    FileKind("run.json in a report", "run.json", _one_run, _report),
    FileKind("runs.jsonl.xz of a study", "runs.jsonl.xz", _study, _tables, digest=True),
    FileKind("sweep.yaml", "sweep.yaml", lambda root: (root.mkdir(parents=True), write_plan(root)), _plan),
    one_file("expected.csv", "expected.csv", _write_expected, _read_expected),
    FileKind("benchmark.csv", "benchmark.csv", _write_latencies, _read_latencies),
    one_file("rows.jsonl", "rows.jsonl", _write_rows, _read_rows),
    FileKind("config.yaml of a run", "config.yaml", _begun_run, _go_on, digest=True, named=("work",)),
    one_file("normalization.json", "normalization.json", _write_normalization, _normalization),
)

KINDS: tuple[FileKind, ...] = (*DATA, *NETWORKS, *RESULTS)
