"""Table 1: what each network costs. Measures what networks.yaml lists, writes results.md, .csv, .tex, .png.

python experiments/table1_efficiency/run.py                # all of it, on an idle machine
python experiments/table1_efficiency/run.py rounds=1 seconds=0.05 memory=false   # a quick look
"""

import csv
import sys
from pathlib import Path

import yaml

import eldenet
from eldenet.benchmark import benchmark, draw, notes_of, text_of
from eldenet.benchmarking import COLUMNS
from eldenet.config import compose
from eldenet.report import to_latex, to_markdown

HERE = Path(__file__).parent


def main() -> None:
    overrides = sys.argv[1:]
    work = next((word[7:] for word in overrides if word.startswith("output=")), "runs/table1_efficiency")
    overrides = [word for word in overrides if not word.startswith("output=")]
    listed = yaml.safe_load((HERE / "networks.yaml").read_text())
    there = eldenet.list_models()
    rows, configs = {}, []
    for part in listed["parts"].values():
        settings = {"models": listed["models"], **listed["settings"], **part}
        settings["models"] = [name for name in settings["models"] if name in there]
        words = [f"{key}={value}".replace("'", "").replace(" ", "") for key, value in settings.items()]
        config = compose("benchmark", [*words, *overrides, f"output='{work}'"])
        configs.append(config)
        rows |= {tuple(row["key"]): row for row in benchmark(config)}
    missing = [name for name in listed["models"] if name not in there]
    write(list(rows.values()), missing, listed["no_code"], Path(work), configs[0])


def write(rows: list[dict], missing: list[str], no_code: list[str], folder: Path, config) -> None:
    """The tables of all parts; one Markdown table for each setting, so that a column compares."""
    notes = notes_of(rows)
    notes += [f"no code identified, so no figures: {', '.join(no_code)}"]
    notes += [f"not in this version: {', '.join(missing)}"] if missing else []
    cells = [[text_of(name, row[name]) for name in COLUMNS] for row in rows]
    with (folder / "results.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([row[name] for name in COLUMNS] for row in rows)
    (folder / "results.md").write_text(to_markdown(COLUMNS, cells, notes))
    (folder / "results.tex").write_text(to_latex(COLUMNS, cells, notes))
    draw(
        config,
        [row for row in rows if (row["batch"], row["precision"], row["threads"]) == (1, "fp32", 1)],
        folder / "results.png",
    )
    print(f"table of {len(rows)} rows in {folder}: copy results.* to {HERE} if the machine was idle")


if __name__ == "__main__":
    main()
