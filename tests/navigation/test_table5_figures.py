"""Figures of tables 5 and 6: ways from above, success and time against density."""

from matplotlib.axes import Axes

from eldenet.navigation.tasks import frozen_arenas


def test_ways_are_drawn_with_their_end(study):
    trajectories, methods = study("trajectories"), study("methods")
    (arena,) = frozen_arenas(40, 1, split="val")
    picture = trajectories.panel(arena, "straight", methods.PLANNERS["straight"](robots=1))
    assert picture.shape == (trajectories.TITLE + trajectories.SIDE, trajectories.SIDE, 3)
    scene = trajectories.Scene(arena, trajectories.SIDE)
    column, row = scene.pixel(*arena.start[:2])
    assert picture[row + trajectories.TITLE, column].tolist() == [30, 100, 220]  # the dot at the start
    assert (picture[: trajectories.TITLE] < 255).any()


def test_no_method_hides_another_in_the_figures(study, tmp_path, monkeypatch):
    """Equal values stand side by side, in one color per method in all panels, whichever a panel has."""
    panels, drawn = study("panels"), []
    errorbar = Axes.errorbar

    def noted(axis, at, values, **options):
        drawn.append((axis.get_subplotspec().num1, options["color"], list(at)))
        return errorbar(axis, at, values, **options)

    monkeypatch.setattr(Axes, "errorbar", noted)
    points = [(5, 90.0, 80.0, 95.0), (80, 50.0, 40.0, 60.0)]
    curves = {("wheels", sensor): {"a": points, "b": points} for sensor in ("one", "two", "three")}
    curves["wheels", "four"] = {"b": points[:1]}
    panels.draw_panels(curves, tmp_path / "figure.png", ylabel="success [%]")
    assert (tmp_path / "figure.png").stat().st_size > 1000
    assert len({tuple(at) for _, _, at in drawn[:2]}) == 2
    assert drawn[-1][:2] == (3, drawn[1][1])
    assert drawn[-1][2] == drawn[1][2][:1]


def test_the_figure_of_the_success_is_that_of_its_csv(study, tmp_path, monkeypatch):
    """From the rows as they are written and as they are read: what is stored can be drawn again."""
    run, drawn = study("run"), []
    monkeypatch.setattr(run, "draw_panels", lambda curves, path, **options: drawn.append(curves))
    rows = [["wheels", "ranges", "dqn", seed, "80", 500, share, share - 1, share + 1] for seed, share in
            ((0, 90.0), (1, 92.0))]  # fmt: skip
    rows.append(["wheels", "ranges", "dqn", 0, "20+10", 500, 50.0, 40.0, 60.0])  # walkers: no density
    for cells in (rows, [[str(value) for value in row] for row in rows]):
        run.plot(cells, tmp_path / "figure.png")
    assert drawn[0] == drawn[1] == {("wheels", "ranges"): {"dqn": [(80, 91.0, 90.0, 92.0)]}}
