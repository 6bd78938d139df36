"""Tables: mean and spread over seeds, and a refusal wherever numbers do not compare."""

import copy
import json
import re
import shutil
from pathlib import Path

import pytest

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.results.report_table import find_runs, group_rows, report_runs, table_of
from eldenet.results.run_log import RunLog
from eldenet.results.tables import protocol_line, to_csv, to_latex, to_markdown
from eldenet.studies.report import write_study_report
from eldenet.train import TrainSettings

RUN = {
    "model": "eldenet",
    "data": "rooms",
    "split": "test",
    "split_hash": "0123456789abcdef",
    "protocol": EvalProtocol("rooms", ground_truth="dense").as_dict(),
    "metrics": {"abs_rel": 0.2, "rmse": 0.5, "mae": 0.4, "mse": 0.25, "delta1": 0.8, "images": 4},
    "constant_predictor": {"abs_rel": 0.4, "rmse": 1.0, "mae": 0.9, "mse": 1.0, "delta1": 0.4, "images": 4},
    "cost": {"params": 587353, "gmacs": 0.1, "gflops": 0.2, "latency_ms_p50": 3.14159}
    | {"runtime": "torch", "precision": "fp32", "threads": 2, "device": "cpu"}
    | {"height": 128, "width": 160, "batch": 8, "throughput_img_s": 321.4},
    "seed": 0,
    "hardware": {"processor": "some processor"},
}
COLUMNS = ("abs_rel", "rmse", "delta1")
EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def run_with(**changes) -> dict:
    """A copy of RUN; ``metrics__delta1=0.9`` changes a nested value."""
    run = copy.deepcopy(RUN)
    for path, value in changes.items():
        *parents, last = path.split("__")
        node = run
        for parent in parents:
            node = node[parent]
        node[last] = value
    return run


def test_seeds_share_a_row_with_mean_and_sample_deviation():
    runs = [run_with(seed=seed, metrics__delta1=value) for seed, value in enumerate((0.7, 0.8, 0.9))]
    titles, rows = table_of(runs, COLUMNS)
    assert titles[:5] == ["model", "seeds", "AbsRel ↓", "RMSE [m] ↓", "δ1 ↑"]
    assert rows[0][:5] == ["eldenet", "3", "0.200 ± 0.000", "0.500 ± 0.000", "0.800 ± 0.100"]
    assert rows[1][:5] == ["constant predictor", "-", "0.400", "1.000", "0.400"]


def test_constant_predictors_of_other_training_frames_are_told_apart():
    runs = [run_with(model=name) for name in ("a", "b", "c", "d")]
    runs += [run_with(model="near", constant_predictor__rmse=2.0), run_with(model="bare")]
    runs[-1]["constant_predictor"] = None
    rows = [row[:4] for row in table_of(runs, COLUMNS)[1]][len(runs) :]
    assert rows == [
        ["constant predictor of a, b, c and 1 more", "-", "0.400", "1.000"],
        ["constant predictor of near", "-", "0.400", "2.000"],
    ]
    assert len(table_of(runs[-1:], COLUMNS)[1]) == 1  # nobody's is shown as another's


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"protocol": EvalProtocol("rooms", ground_truth="dense", average="pixel").as_dict()}, "protocol"),
        ({"split_hash": "another"}, "split_hash"),
        ({"data": "nyu_mat"}, "data"),
        ({"cost__device": "GPU"}, "device"),
        ({"cost__threads": 1}, "threads"),
        ({"cost__height": 224}, "height"),
        ({"hardware__processor": "another"}, "processor"),
    ],
)
def test_what_does_not_compare_is_refused(changes, word):
    runs = [RUN, run_with(model="other", **changes)]
    with pytest.raises(ValueError, match=f"^eldenet and other cannot be compared: {word} differs"):
        table_of(runs, COLUMNS)
    if "__" in next(iter(changes)):  # costs apart, the metrics still compare
        titles, _ = table_of(runs, COLUMNS, costs=False)
        assert "params ↓" not in titles


def test_runs_on_other_depth_of_the_same_frames_are_refused():
    runs = [run_with(model=name, metrics__pixels=count) for name, count in (("a", 900), ("b", 700))]
    words = "^a and b cannot be compared: they scored 900 and 700 pixels of frames of the same names"
    for costs in (True, False):
        with pytest.raises(ValueError, match=words):
            table_of(runs, COLUMNS, costs=costs)


def test_the_same_seed_twice_is_refused():
    with pytest.raises(ValueError, match=r"seeds .* repeat"):
        table_of([RUN, RUN], COLUMNS)


def test_markdown_and_latex():
    titles, rows = table_of([RUN], COLUMNS)
    markdown = to_markdown(titles, rows, ["a note"]).splitlines()
    assert markdown[0].startswith("| model | seeds | AbsRel ↓ | RMSE [m] ↓ | δ1 ↑ | params ↓ | GMACs ↓ |")
    assert markdown[2] == ("| eldenet | 1 | 0.200 | 0.500 | 0.800 | 0.587 M | 0.100 | 0.200 | 3.14 | 321 |")
    assert markdown[-1] == "- a note"
    assert all(line.count("|") == markdown[0].count("|") for line in markdown[:4])
    name = "a|b_c & 50% {x}"  # signs of Markdown and LaTeX do not break a table
    renamed = [[name, *rows[0][1:]]]
    assert to_markdown(titles, renamed, []).splitlines()[2].startswith(r"| a\|b_c & 50% {x} | 1 |")
    latex = to_latex(titles, renamed, ["a note"])
    assert r"a|b\_c \& 50\% \{x\} & 1 & 0.200" in latex
    assert r"$\delta$1 $\uparrow$" in latex
    assert latex.count("&") == 2 * (len(titles) - 1) + 1


def test_other_settings_are_no_seeds():
    configs = ({"optimizer": {"lr": lr}, "seed": seed} for seed, lr in ((0, 1e-3), (1, 1e-2)))
    runs = [run_with(seed=config["seed"], config=config) for config in configs]
    with pytest.raises(ValueError, match=r"optimizer differs"):
        table_of(runs, COLUMNS)
    runs[1]["config"]["optimizer"]["lr"] = 1e-3
    assert table_of(runs, COLUMNS)[1][0][1] == "2"
    for run, size in zip(runs, ([96, 128], [240, 320]), strict=True):  # without costs, nothing else tells
        run["config"]["data"] = {"input_size": size, "root": f"/{size}"}
    with pytest.raises(ValueError, match=r"data differs .*data\.input_size=\[96, 128\]"):
        table_of(runs, COLUMNS, costs=False)


@pytest.mark.parametrize(
    ("cost", "word"),
    [
        ({"height": 96, "width": 128}, "height=128 .there 96"),
        ({"precision": "int8"}, "precision=fp32 .there int8"),
        ({"params": 9}, "params"),
    ],
)
def test_evaluations_of_other_networks_or_inputs_are_no_seeds(cost, word):
    one, two = run_with(seed=0), run_with(seed=1)
    two["cost"] |= cost
    with pytest.raises(ValueError, match=rf"network differs .*{word}"):
        table_of([one, two], costs=False)


def started(seed: int, place: str, content: str) -> dict:
    return run_with(seed=seed, config={"weights": place}, sources={"weights": content})


def test_seeds_start_from_the_same_weights_or_each_from_its_own() -> None:
    group_rows([started(seed, "runs/start/seed0", "0a") for seed in (0, 1)])
    group_rows([started(seed, f"runs/start/seed{seed}", f"{seed}a") for seed in (0, 1)])
    with pytest.raises(ValueError, match="sources differs"):  # seed10's is not seed 1's own
        group_rows([started(seed, f"runs/start/seed{seed}0", f"{seed}a") for seed in (0, 1)])
    with pytest.raises(ValueError, match=r"sources differs.*weights=0a \(there 1a\)"):
        group_rows([started(seed, "runs/start/seed0", f"{seed}a") for seed in (0, 1)])


def test_a_missing_value_is_shown_as_missing():
    runs = [run_with(seed=seed, constant_predictor__rmse=None) for seed in (0, 1)]
    runs[1]["metrics"]["rmse"] = None
    _, rows = table_of(runs[::-1], COLUMNS)
    assert [row[3] for row in rows] == ["-", "-"]
    with pytest.raises(ValueError, match=r"columns=\['absrel'\]"):
        table_of([RUN], ("absrel",))


@pytest.mark.parametrize(
    "runs",
    [[run_with(cost__waiting=2.1)], [run_with(), run_with(seed=1, cost__latency_ms_p50=4.8)]],
    ids=["other jobs had the processor", "two runs differ"],
)
def test_times_of_a_busy_machine_are_marked_and_stay_out_of_latex(runs, tmp_path):
    runs.append(run_with(model="calm", cost__waiting=1.1))
    for number, run in enumerate(runs):
        store(tmp_path / str(number), run)
    report_runs([str(tmp_path)], tmp_path / "t", columns=["delta1"])
    (shown,) = re.findall(r"^\| eldenet \|.*?\| ([\d.]+ \(busy\)) \|", (tmp_path / "t.md").read_text(), re.M)
    assert shown == f"{sum(run['cost']['latency_ms_p50'] for run in runs[:-1]) / (len(runs) - 1):.2f} (busy)"
    for name in ("t.tex", "t.csv"):
        lines = [line for line in (tmp_path / name).read_text().splitlines() if line[:1] not in "%{"]
        assert "busy" not in "".join(lines), name
        assert sum("3.14" in line for line in lines) == 1, name  # that of the other network
    assert "(busy): other jobs used the machine" in (tmp_path / "t.md").read_text()


def store(folder, record: dict) -> None:
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps(record))


def test_runs_are_found_and_damaged_ones_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        find_runs([str(tmp_path / "none")])
    with pytest.raises(FileNotFoundError, match=r"no run\.json below"):
        find_runs([str(tmp_path)])
    for name in ("b", "a"):
        store(tmp_path / name, run_with(model=name))
    assert [run["model"] for run in find_runs([str(tmp_path)])] == ["a", "b"]
    (alone,) = find_runs([str(tmp_path / "a" / "run.json")])
    assert Path(alone["run"]).resolve() == tmp_path / "a"
    assert len(find_runs([str(tmp_path), str(tmp_path / "a")])) == 2  # not twice
    (tmp_path / "a" / "run.json").write_text("{")
    with pytest.raises(ValueError, match="not a valid JSON file"):
        find_runs([str(tmp_path)])
    (tmp_path / "a" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match="has no metrics"):
        find_runs([str(tmp_path)])


@pytest.mark.parametrize("record", [{"metrics": {"5": 1}, "policy": "dwa"}, {"mode": "watch"}])
def test_records_of_other_commands_are_no_rows(tmp_path, record):
    """``runs=[runs]`` holds films and detectors, too."""
    store(tmp_path / "depth", RUN)
    store(tmp_path / "other", record)
    assert [run["model"] for run in find_runs([str(tmp_path)])] == ["eldenet"]
    with pytest.raises(
        ValueError,
        match=r"has no (metrics|protocol): it is damaged, or another program",
    ):
        find_runs([str(tmp_path / "other" / "run.json")])


def test_runs_of_before_a_rule_existed_still_compare(tmp_path):
    old = run_with(seed=1)
    for rule in ("crop_fractions", "frame_box", "frame_anchor", "frame_size", "paste"):
        del old["protocol"][rule]
    store(tmp_path / "new", run_with(seed=0))
    store(tmp_path / "old", old)
    assert table_of(find_runs([str(tmp_path)]), COLUMNS)[1][0][1] == "2"


@pytest.mark.parametrize(
    ("name", "scored"),
    [
        ("rooms", "10 m, no crop, mean"),
        ("nyu_bts", "10 m, crop (45, 471, 41, 601), mean"),
        ("cityscapes_paper", "frame resized to (128, 256), all of it scored"),
        ("kitti_paper", "cut to (352, 1216) at the bottom, then resized to (228, 912), all of it scored"),
        ("kitti_s2d_912x228", "cut to (130, 370, 10, 1210), then cut to (228, 912) at the center, all"),
        (
            "kitti_eigen_garg_improved",
            "80 m, crop (0.4081, 0.9919, 0.0359, 0.9641) of height and width, scored where predicted: "
            "(352, 1216) at the bottom, mean",
        ),
    ],
)
def test_the_protocol_line_says_what_of_the_frame_is_scored(name, scored):
    rules = instantiate(compose(TrainSettings, [f"protocol={name}"]).protocol).as_dict()
    rules = json.loads(json.dumps(rules))  # as a run.json holds them
    assert scored in protocol_line(run_with(protocol=rules))


def seven(**changes) -> dict:
    """A run with all seven metrics."""
    run = run_with(**changes)
    for group in ("metrics", "constant_predictor"):
        run[group] |= {"delta2": 0.9, "delta3": 0.95}
    return run


def printed(width: int, titles, rows, core, tmp_path, capsys, monkeypatch) -> list[str]:
    monkeypatch.setenv("COLUMNS", str(width))
    RunLog(tmp_path).table("a title", titles, rows, core)
    return capsys.readouterr().out.splitlines()


def test_a_narrow_terminal_drops_columns_and_says_so_but_never_digits(tmp_path, capsys, monkeypatch):
    runs = [seven(seed=seed, model="a_rather_long_name", metrics__delta1=0.8 + seed / 10) for seed in (0, 1)]
    titles, rows = table_of(runs, costs=False)
    core = [titles.index(name) for name in ("AbsRel ↓", "RMSE [m] ↓", "δ1 ↑")]
    there = (titles, rows, core, tmp_path, capsys, monkeypatch)
    narrow, wide = printed(80, *there), printed(120, *there)
    assert max(map(len, narrow)) <= 80
    assert max(map(len, wide)) <= 120
    for text in ("AbsRel ↓", "RMSE [m] ↓", "δ1 ↑", "0.850±0.071", "0.200±0.000", "a_rather_long_name"):
        assert any(text in line for line in narrow), text
    assert narrow[-1] == "no room for MSE [m²] ↓, δ2 ↑, δ3 ↑: use a wider terminal, or the files"
    for title in titles:
        assert title in wide[1]
    assert "no room" not in "".join(wide)
    tiny = printed(54, *there)  # a name is wrapped before a digit is lost
    assert any("0.200±0.000  0.500±0.000  0.850±0.071" in line for line in tiny)
    titles = ["model", "runtime", "params", "gmacs", "gflops", "latency_ms_p50", "fps", "ratio_latency"]
    row = ["a_name_of_30_characters_or_so_", "torch_channels_last", "587,353"]
    row += ["0.092", "0.184", "16.41", "60.94", "1.000"]
    assert printed(80, titles, [row], [1, 2, 3, 5, 6, 7], *there[3:])[3].endswith("16.41  60.94")


def test_csv_has_a_column_for_each_figure():
    titles = ["row", "δ1 ↑", "delta1 - eldenet's [95 %]", "params ↓"]
    rows = [
        ["a", "0.554 ± 0.004", "-", "0.587 M"],
        ["b", "0.501", "-0.036 [-0.058, -0.012] worse", "12.397 M"],
        ["c", "-", "+0.020 [-0.010, +0.049]", "-"],
    ]
    assert to_csv(titles, rows) == (
        ["row", "δ1 ↑", "δ1 std", "delta1 - eldenet's [95 %]", "low", "high", "verdict", "params [M] ↓"],
        [
            ["a", "0.554", "0.004", "", "", "", "", "0.587"],
            ["b", "0.501", "", "-0.036", "-0.058", "-0.012", "worse", "12.397"],
            ["c", "-", "", "+0.020", "-0.010", "+0.049", "", "-"],
        ],
    )


def width_in_points(tabular: str) -> float:
    """Width of a tabular in Computer Modern: its widest cells and the gaps."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    size = 8 if r"\footnotesize" in tabular else 9
    font = ImageFont.truetype(f"{get_data_path()}/fonts/ttf/cmr10.ttf", 10 * size)  # ten times as large
    kinds = re.findall(r"[lr]|p\{7em\}", re.search(r"begin\{tabular\}\{(.*)\}", tabular)[1])
    widths = [0.0] * len(kinds)
    for line in tabular.splitlines():
        if "&" in line and not line.startswith("%"):
            for place, cell in enumerate(line.removesuffix(r"\\").split(" & ")):
                text = re.sub(r"\$\\\w+\$", "m", re.sub(r"\\([_%&#])", r"\1", cell)).replace("$^2$", "2")
                length = font.getlength(text.strip()) / 10
                widths[place] = max(widths[place], 7 * size if kinds[place].startswith("p") else length)
    return sum(widths) + 2 * 3 * len(kinds)


@pytest.mark.parametrize("name", ["first_training", "rooms_pretraining", "table2_accuracy"])
def test_the_latex_of_a_study_fits_a_page(name, tmp_path):
    shutil.copytree(EXPERIMENTS / "table3_rivals", tmp_path / "table3_rivals")  # table 2 has rows of it
    shutil.copytree(EXPERIMENTS / name, tmp_path / name)
    write_study_report(tmp_path / name)
    tables = (tmp_path / name / "results.tex").read_text().split(r"\end{tabular}}")[:-1]
    assert tables
    assert max(map(width_in_points, tables)) <= 345


def test_runs_of_a_sweep_are_named_by_the_settings_that_differ():
    runs = [
        run_with(seed=seed, config={"loss": loss}, overrides=[f"seed={seed}", *given, "output=runs/sweep"])
        for loss, given in (("SSIM and L1", ["loss=ssim_l1"]), ("L1", ["loss=l1"]), ("SSIM and L1 ", []))
        for seed in (0, 1)
    ]
    assert [row.model for row in group_rows(runs)] == ["eldenet loss=ssim_l1", "eldenet loss=l1", "eldenet"]
    assert [len(row.runs) for row in group_rows(runs)] == [2, 2, 2]
    assert [row.model for row in group_rows(runs[:2])] == ["eldenet"]


def test_finished_runs_can_be_renamed(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(seven(config={"loss": name})))
    sources = [str(tmp_path / "a"), str(tmp_path / "b")]
    runs = find_runs(sources, names=["baseline", "ours"])
    assert [row[0] for row in table_of(runs)[1]] == ["baseline", "ours", "constant predictor"]
    with pytest.raises(ValueError, match=r"give one name for each of the 2 runs"):
        find_runs(sources, names=["ours"])
