"""Put our stored figures beside those that the paper's prose publishes, for tables 1, 4, 5 and 6.

python experiments/beside_paper.py    # from beside_paper.csv and each folder's results
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from eldenet.results.tables import to_markdown
from eldenet.system.files import read_table

HERE = Path(__file__).parent
HEADER = ("table", "claim", "paper", "unit", "quote")
MODELS = ("eldenet", "eldenet_paper")
RUNTIMES = ("torch_channels_last", "onnxruntime", "openvino")
MOBILENETS = (
    "mobilenet_v1_upconv",
    "mobilenet_v2_upconv",
    "mobilenet_v3_upconv",
    "mobilenet_v3_small_upconv",
)
SENETS = ("seresnet18_upconv", "seresnet50_upconv")
Ours = Sequence[tuple[str, Mapping[str, str]]]  # title of a column, cells by claim

Row = dict[str, str]


def efficiency() -> tuple[Ours, list[str]]:
    """Ratios of our networks to others: of one 224 x 224 image, or of batches of 8 for throughput."""
    stored = read_table(HERE / "table1_efficiency/benchmark.csv", ())

    def value(
        model: str, runtime: str, column: str, batch: str = "1", precision: str = "fp32"
    ) -> float | None:
        threads = "1" if batch == "1" else "2"
        wanted = {"model": model, "batch": batch, "threads": threads, "precision": precision}
        # torch's default layout stands for networks that were not measured in channels_last
        layouts = (runtime, "torch") if runtime == "torch_channels_last" else (runtime,)
        for layout in layouts:
            for row in stored:
                if wanted.items() <= row.items() and row["runtime"] == layout and row[column]:
                    return float(row[column])
        return None

    def latencies(ours: str, models: Sequence[str], runtime: str) -> list[float]:
        """Latency of each, relative to that of ``ours`` in the same part of the benchmark."""
        found = []
        for model in models:
            for part in dict.fromkeys(row["part"] for row in stored):
                rows = {
                    row["model"]: float(row["latency_ms_p50"])
                    for row in stored
                    if (row["part"], row["batch"], row["threads"], row["precision"])
                    == (part, "1", "1", "fp32")
                    and row["runtime"] in (runtime, "torch" if runtime.startswith("torch") else runtime)
                    and row["latency_ms_p50"]
                }
                if model in rows and ours in rows:
                    found.append(rows[model] / rows[ours])
                    break
        return found

    def span(values: Sequence[float], form: str = "{:.1f}") -> str:
        if not values:
            return "-"
        ends = [form.format(end) for end in (min(values), max(values))]
        return ends[0] if len(values) == 1 else f"{ends[0]} to {ends[1]}"

    columns = []
    for model in MODELS:
        for runtime in RUNTIMES:
            params = value(model, runtime, "params"), value("resnet18_upconv", runtime, "params")
            batches = [value(m, runtime, "throughput_img_s", "8") for m in (model, "resnet18_upconv")]
            throughput = [batches[0] / batches[1]] if batches[0] else []
            mobile, senet = latencies(model, MOBILENETS, runtime), latencies(model, SENETS, runtime)
            resnet = latencies(model, ["resnet18_upconv"], runtime)
            cells = {
                "parameters / those of ResNet18 + UpConv": f"{params[0] / params[1]:.3f}",
                "latency of ResNet18 + UpConv / latency": span(resnet),
                "throughput / that of ResNet18 + UpConv": span(throughput),
                "throughput / that of the MobileNet family": span(mobile),
                "latency / that of the MobileNet family": span([100 / ratio for ratio in mobile], "{:.0f}"),
                "frames per second / those of the SENet family": span(senet),
                "frames per second / those of MobileNet": span(latencies(model, MOBILENETS[:1], runtime)),
                "frames per second / those of MobileNetV2": span(latencies(model, MOBILENETS[1:2], runtime)),
                "frames per second / those of ResNet18 + UpConv": span(resnet),
            }
            columns.append((f"{model}, {runtime}", cells))
    notes = [
        "224 x 224, fp32, one thread of a CPU and one image at a time; throughput beside ResNet18 + UpConv: "
        "batches of 8 on two threads. We had no Jetson: its lines have the CPU's ratios",
        "all rivals have the UpConv decoder in its fast form, which the paper's may not",
        "`eldenet_paper` is the paper's network as we read its prose, `eldenet` our own; the former ends "
        "in a bilateral filter at the full size, which `eldenet` does not have",
        "a dash: not measured in the same rounds",
        "from table1_efficiency/benchmark.csv",
    ]
    return columns, notes


def centers() -> tuple[Ours, list[str]]:
    """Our two definitions of what the paper names, for three kinds of depth."""
    columns = []
    for row in read_table(HERE / "table4_centres/results_rows.csv", ()):
        shown = ("street: ELDE-Net", "hall: ELDE-Net", "KITTI: meter_kitti")
        if "leak" in row["2D boxes"] or row["group"] not in ("all", "vehicles"):
            continue
        if row["depth"] in shown and row["method"] in ("refine", "paper"):
            cells = {
                "accuracy of the estimated centers": row["accuracy"],
                "match rate of the object predictions": row["bev_25"],
            }
            columns.append((f"{row['depth']}, {row['method']} ({row['objects']} objects)", cells))
    notes = [
        "the paper defines neither figure: ours are the center accuracy below results.md and BEV > 0.25",
        "brackets: 95 % intervals. 2D boxes: the simulator's, on KITTI YOLOX's; the paper's are YOLOv9's",
        "from table4_centres/results_rows.csv",
    ]
    return columns, notes


def crossings(name: str, column: str, form: str) -> Callable[[], tuple[Ours, list[str]]]:
    """A column of the navigation tables by the number of obstacles, the mean over trainings."""

    def made() -> tuple[Ours, list[str]]:
        stored = [row for row in read_table(HERE / name / "tables.csv", ()) if row["table"] == "results-500"]
        columns = []
        for method in ("dqn_ensemble", "dqn", "paper_literal", "astar_dwa", "dwa"):
            cells = {}
            for course in ("5", "20", "40", "80"):
                values = [
                    float(row[column])
                    for row in stored
                    if (row["method"], row["course"], row["sensor"]) == (method, course, "ranges")
                ]
                if values:
                    cells[f"{course} obstacles in 400 m²"] = form.format(sum(values) / len(values))
            if cells:
                columns.append((method, cells))
        notes = [
            "the paper's table is missing from our copy of the text, which only has its setup",
            "500 test arenas, true ranges, wheels in MuJoCo; the mean over the trainings of a method",
            f"from results-500 of {name}/tables.csv",
        ]
        return columns, notes

    return made


TABLES: dict[str, Callable[[], tuple[Ours, list[str]]]] = {
    "table1_efficiency": efficiency,
    "table4_centres": centers,
    "table5_success": crossings("table5_success", "success", "{:.1f}"),
    "table6_time": crossings("table6_time", "seconds", "{:.1f}"),
}


def page(folder: str) -> str:
    """Markdown of the paper's figures for a folder's table beside ours."""
    columns, notes = TABLES[folder]()
    titles = ["claim", "unit", "the paper", "in its words", *(title for title, _ in columns)]
    rows = [
        [line["claim"], line["unit"], line["paper"] or "missing from our copy of the text", line["quote"]]
        + [cells.get(line["claim"], "-") for _, cells in columns]
        for line in read_table(HERE / "beside_paper.csv", HEADER)
        if line["table"] == folder
    ]
    return f"## [{folder}]({folder}/README.md)\n\n{to_markdown(titles, rows, notes)}"


def main() -> None:
    head = "# Beside the paper\n\nMade by `python experiments/beside_paper.py`.\n"
    (HERE / "beside_paper.md").write_text("\n".join([head, *map(page, TABLES)]))


if __name__ == "__main__":
    main()
