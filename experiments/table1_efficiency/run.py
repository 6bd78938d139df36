"""Table 1: costs of the networks in networks.yaml. Writes results.md, .csv, .tex and .png.

python experiments/table1_efficiency/run.py                # all of it, on an idle machine
python experiments/table1_efficiency/run.py rounds=1 seconds=0.05 memory=false   # a quick look
"""

import sys
from pathlib import Path

import yaml

import eldenet
from eldenet.benchmark import BenchmarkSettings, benchmark
from eldenet.compose import compose, listed
from eldenet.deploy.benchmarking.measure import COLUMNS
from eldenet.deploy.benchmarking.tables import draw, notes_of, read_accuracies, text_of
from eldenet.results.tables import to_latex, to_markdown
from eldenet.system.files import write_rows

HERE = Path(__file__).parent


def main() -> None:
    overrides = sys.argv[1:]
    work = next((word[7:] for word in overrides if word.startswith("output=")), "runs/table1_efficiency")
    overrides = [word for word in overrides if not word.startswith("output=")]
    listed = yaml.safe_load((HERE / "networks.yaml").read_text())
    there = eldenet.list_models()
    tables, first = {}, None
    for name, part in listed["parts"].items():
        settings = {"models": listed["models"], **listed["settings"], **part}
        settings["models"] = [model for model in settings["models"] if model in there]
        words = [f"{key}={value}".replace("'", "").replace(" ", "") for key, value in settings.items()]
        # a folder of its own: a column compares rows that were measured in the same rounds
        s = compose(BenchmarkSettings, [*words, *overrides, f"output='{work}/{name}'"])
        first = first or s
        tables[name] = benchmark(s)
    missing = [name for name in listed["models"] if name not in there]
    write(tables, missing, listed["no_code"], Path(work), first)


def write(tables: dict[str, list[dict]], missing: list[str], no_code: list[str], folder: Path, s) -> None:
    """One table for each part, with a heading; a CSV of all rows, by part; the plot of the first part."""
    every = {(name, *row["key"]): row for name, rows in tables.items() for row in rows}
    notes = [
        note.replace("made by `run.py", "made by `python experiments/table1_efficiency/run.py")
        for note in notes_of(list(every.values()))
    ]
    notes += [f"no code identified, so no figures: {', '.join(no_code)}"]
    notes += [f"not in this version: {', '.join(missing)}"] if missing else []
    lines = [[key[0], *(row[name] for name in COLUMNS)] for key, row in every.items()]
    write_rows(folder / "benchmark.csv", ["part", *COLUMNS], lines)
    markdown, latex = [], []
    for number, (name, rows) in enumerate(tables.items(), 1):
        cells = [[text_of(column, row[column]) for column in COLUMNS] for row in rows]
        below = notes if number == len(tables) else []
        markdown.append(f"## {name}\n\n{to_markdown(COLUMNS, cells, below)}")
        latex.append(f"% {name}\n{to_latex(COLUMNS, cells, below)}")
    (folder / "results.md").write_text("\n".join(markdown))
    (folder / "results.tex").write_text("\n".join(latex))
    rows = next(iter(tables.values()))
    accuracies = read_accuracies(listed(s.accuracies), s.accuracy, {row["model"] for row in rows})
    draw(rows, accuracies, folder / "results.png")
    print(f"{len(every)} rows in {folder}: copy results.* to {HERE} if the machine was idle")


if __name__ == "__main__":
    main()
