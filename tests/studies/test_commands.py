"""The commands of a study, in this process's place and as jobs."""

import re
import shutil

import pytest
from support.tiny_study import cells, short

from eldenet.compose import compose, config_folder
from eldenet.results.packed_runs import RUNS, read_records
from eldenet.train import TrainSettings


@pytest.mark.slow
def test_the_commands_run_and_report_a_study(tiny, run_command):
    plan = tiny / "sweep.yaml"
    plan.write_text(short(plan.read_text()))
    finished = run_command("study", "-m", f"study={tiny}", "rows=[wrong,eldenet_s]", cwd=tiny.parent)
    assert finished.returncode == 1
    assert "wrong/seed0" in finished.stderr
    for asked in ("seeds=[0,5]", "seeds=5"):
        unknown = run_command("study", f"study={tiny}", "rows=[eldenet]", asked, cwd=tiny.parent)
        assert unknown.returncode == 1
        assert "seeds=[5]: the chosen rows have the seeds 0;" in unknown.stderr
    assert "eldenet_s/seed0" in read_records(tiny / RUNS)  # the failed row lost nothing
    finished = run_command("report", f"study={tiny}", cwd=tiny.parent)
    assert finished.returncode == 0, finished.stderr
    assert "eldenet_s" in (tiny / "results.md").read_text()


@pytest.mark.slow
def test_a_row_with_a_network_from_outside_the_tree(tiny, run_command):
    """``--config-dir`` reaches the runs of a study, and its report."""
    project = tiny.parent
    (project / "my_configs" / "model").mkdir(parents=True)
    shutil.copyfile(config_folder() / "model/eldenet_s.yaml", project / "my_configs/model/mine.yaml")
    plan = (tiny / "sweep.yaml").read_text()
    (tiny / "sweep.yaml").write_text(
        short(plan) + "  mine: {overrides: [model=mine], learning_rate: 1.0e-3}\n"
    )
    added = ("--config-dir", "my_configs", f"study={tiny}")
    finished = run_command("study", *added, "rows=[mine]", cwd=project)
    assert finished.returncode == 0, finished.stderr + finished.stdout
    finished = run_command("report", *added, cwd=project)
    assert finished.returncode == 0, finished.stderr
    assert cells(tiny)["scratch/mine"]["seeds"] == "1"
    with pytest.raises(ValueError, match="mine"):  # nothing is left behind where nobody asked for it
        compose(TrainSettings, ["model=mine"])


@pytest.mark.slow
def test_submitit_runs_a_row(tiny, run_command):
    """On this machine: what Slurm itself does is not tried here."""
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="pip install -e '.[cluster]'")
    (tiny / "sweep.yaml").write_text(short((tiny / "sweep.yaml").read_text()))
    finished = run_command(
        *("study", "-m", f"study={tiny}", "rows=[eldenet_s]", "hydra/launcher=submitit_local"),
        "hydra.launcher.timeout_min=10",
        cwd=tiny.parent,
    )
    assert finished.returncode == 0, finished.stderr[-3000:]
    assert "eldenet_s/seed0" in read_records(tiny / RUNS)
    assert list(tiny.parent.rglob("*_result.pkl"))  # submitit's own: its job ended


@pytest.mark.slow
def test_rays_workers_run_the_rows(tiny, run_command):
    pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="pip install -e '.[cluster]'")
    plan = tiny / "sweep.yaml"
    plan.write_text(short(plan.read_text()))
    finished = run_command(
        *("study", "-m", f"study={tiny}", "rows=[eldenet_s,eldenet]", "hydra/launcher=ray"),
        "+hydra.launcher.ray.init.num_cpus=2",
        cwd=tiny.parent,
    )
    assert finished.returncode == 0, finished.stderr[-3000:]
    assert {"eldenet_s/seed0", "eldenet/seed0"} <= set(read_records(tiny / RUNS))
    workers = set(re.findall(r"_run_job pid=(\d+)", finished.stdout + finished.stderr))
    assert len(workers) == 2, finished.stdout[-2000:]
