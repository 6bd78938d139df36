"""Estimate the effect of each change from the stored runs: effects.md.

python experiments/recipe_screening/effects.py
"""

from pathlib import Path

import numpy as np
from scipy.stats import t

from eldenet.results.tables import to_markdown
from eldenet.studies.plan import Study, StudyRow, read_study

HERE = Path(__file__).resolve().parent
METRICS = ("delta1", "rmse", "abs_rel")
CHANGES = {  # columns of the design; "nothing" changes nothing, so its effect shows the size of chance
    "model/head=inverse": "model/head=inverse",
    "loss.terms.l1.weight=0.1": "loss.terms.l1.weight=0.1",
    "BerHu in place of L1": "loss.terms.l1.loss._target_=eldenet.losses.pointwise.BerHuLoss",
    "trainer.batch_size=8": "trainer.batch_size=8",
    "trainer.ema_decay=0.99": "trainer.ema_decay=0.99",
    "trainer.max_grad_norm=1": "trainer.max_grad_norm=1.0",
    "optimizer.lr=2e-3": "optimizer.lr=2.0e-3",
    "AdamW, weight decay 0.05": "optimizer=adamw",
    "zoom up to 1.6": "augmentation.scale=[1.0,1.6]",
    "colors changed twice as often": "augmentation.color_jitter=0.6",
}
NOTHING = ("run_02", "run_06", "run_07", "run_08", "run_10", "run_11")


def effects(study: Study) -> dict[str, dict[str, float]]:
    """Return change -> metric -> mean of the runs with the change minus mean of the runs without it.

    Plackett and Burman, "The design of optimum multifactorial experiments", 1946: any two columns are
    balanced, so the other changes cancel, except for interactions of two changes.
    """
    rows = designed(study)
    runs = {row.name: study.stored(row, 0)["metrics"] for row in rows}
    with_it = {
        name: [row.name for row in rows if override in row.overrides] for name, override in CHANGES.items()
    }
    with_it["(nothing)"] = list(NOTHING)
    return {
        name: {metric: _contrast(runs, chosen, metric) for metric in METRICS}
        for name, chosen in with_it.items()
    }


def designed(study: Study) -> list[StudyRow]:
    """Return the twelve runs of the design; the other rows test its conclusions."""
    return [row for row in study.rows if row.name.startswith("run_")]


def predicted(study: Study, row: StudyRow, found: dict[str, dict[str, float]], metric: str) -> float:
    """Return ``metric`` of another row if effects add up: the mean plus or minus half of each effect."""
    mean = np.mean([study.stored(one, 0)["metrics"][metric] for one in designed(study)])
    signs = {name: 1 if override in row.overrides else -1 for name, override in CHANGES.items()}
    return float(mean + sum(sign * found[name][metric] / 2 for name, sign in signs.items()))


def _contrast(runs: dict[str, dict[str, float]], chosen: list[str], metric: str) -> float:
    on = [values[metric] for name, values in runs.items() if name in chosen]
    off = [values[metric] for name, values in runs.items() if name not in chosen]
    return float(np.mean(on) - np.mean(off))


def margin(values: list[float]) -> float:
    """Return the size beyond which an effect is more than chance, estimated from the effects themselves.

    Lenth, "Quick and easy analysis of unreplicated factorials", 1989: most effects are assumed to be zero.
    """
    sizes = np.abs(values)
    rough = 1.5 * np.median(sizes)
    error = 1.5 * np.median(sizes[sizes < 2.5 * rough])
    return float(t.ppf(0.975, len(values) / 3) * error)


def main() -> None:
    """Write ``effects.md`` beside this file."""
    study = read_study(HERE)
    found = effects(study)
    rows = [
        [name, *(f"{values[metric]:+.3f}" for metric in METRICS)]
        for name, values in sorted(found.items(), key=lambda item: -item[1]["delta1"])
    ]
    limits = [margin([values[metric] for values in found.values()]) for metric in METRICS]
    rows.append(["beyond chance from", *(f"± {limit:.3f}" for limit in limits)])
    notes = [
        "mean of the six runs with a change less that of the six without; last row: Lenth's margin, 95 %",
        "Made by `python experiments/recipe_screening/effects.py`.",
    ]
    notes[1:1] = [
        f"{row.name}: predicted by adding up "
        + ", ".join(f"{metric} {predicted(study, row, found, metric):.3f}" for metric in METRICS)
        for row in study.chosen(["together", "batch_8"])
    ]
    text = to_markdown(["change", "δ1 ↑", "RMSE [m] ↓", "AbsRel ↓"], rows, notes)
    (HERE / "effects.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
