"""A plan and stored runs of it as trainings leave them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.evaluation.metric_names import METRICS
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.results.packed_runs import RUNS, add_record, read_records
from eldenet.studies.matching import run_overrides
from eldenet.studies.plan import Study, read_study, training_settings
from eldenet.studies.tables import build_blocks

PLAN = """
overrides: [data=rooms, "data.frames={train: 16, val: 4, test: 6}", trainer.epochs=3]
learning_rate: 1.0e-3
seeds: [0, 1, 2]
reference: [small]
columns: [rmse, delta1]
rows:
  small: {overrides: [model=eldenet_s]}
  large: {overrides: [model=eldenet]}
  other: {overrides: [model=fastdepth], block: rooms}
"""
IMAGES = [f"room/{index}" for index in range(40)]


def write_plan(folder: Path, old: str = "", new: str = "") -> Study:
    (folder / "sweep.yaml").write_text(PLAN.replace(old, new))
    return read_study(folder)


def settings_of(overrides: Sequence[str], name: str, seed: int = 0) -> dict[str, Any]:
    """Resolved settings of a run of a study."""
    return training_settings(run_overrides(overrides, Path("f"), Path("r"), name=name, seed=seed))


def record_of(study: Study, name: str, seed: int, delta1: np.ndarray, **changes: Any) -> dict[str, Any]:
    """``run.json`` of a run with this delta1 of its images."""
    (row,) = study.chosen(name)
    config = settings_of([*study.overrides_of(row), "optimizer.lr=1.0e-3"], name, seed)
    return {
        "model": name,
        "seed": seed,
        **{"data": "rooms", "split": "test", "split_hash": "abc", "train_split_hash": "def"},
        "protocol": EvalProtocol("rooms", ground_truth="dense").as_dict(),
        "metrics": dict.fromkeys(METRICS, 0.5) | {"delta1": float(delta1.mean()), "images": len(delta1)},
        "constant_predictor": None,
        "cost": {"params": 100, "gmacs": 1.0, "gflops": 2.0, "latency_ms_p50": 7.0, "throughput_img_s": 9.0}
        | {"runtime": "torch", "precision": "fp32", "threads": 1, "device": "cpu"}
        | {"height": 96, "width": 128, "batch": 8},
        "hardware": {"processor": "some", "accelerator": None},
        "versions": {"torch": "2"},
        "resources": {"precision": "bf16"},
        "date": "2026-01-01T00:00:00",
        "sources": {},
        "config": config,
    } | changes


def store(study: Study, name: str, seed: int, delta1: np.ndarray, **changes: Any) -> dict[str, Any]:
    """Store a run and return its ``run.json``."""
    run = record_of(study, name, seed, delta1, **changes)
    images = {"name": IMAGES[: len(delta1)], "delta1": delta1.tolist()}
    add_record(study.folder, f"{name}/seed{seed}", run | {"per_image": images})
    return run


def change_run(study: Study, name: str, **changes: Any) -> None:
    """Change entries of a stored run such as ``small/seed0``."""
    add_record(study.folder, name, read_records(study.folder / RUNS)[name] | changes)


def table(study: Study, block: str = "scratch") -> dict[str, dict[str, str]]:
    """Row -> title -> cell."""
    (found,) = [one for one in build_blocks(study) if one.name == block]
    return {row[0]: dict(zip(found.titles, row, strict=True)) for row in found.rows}


def notes(study: Study) -> list[str]:
    return build_blocks(study)[0].notes


def figures(offset: float, seed: int) -> np.ndarray:
    """delta1 of all images, 0.5 + ``offset`` in the mean."""
    return 0.5 + offset + 0.02 * np.random.default_rng(seed).standard_normal(len(IMAGES))


def history(mse: Sequence[float]) -> list[dict[str, float]]:
    """History of a training with this validation MSE after each epoch."""
    return [
        {"epoch": epoch, "train_total": value, "val_mse": value, "val_ssim": 0.9, "val_mae": value}
        for epoch, value in enumerate(mse, 1)
    ]
