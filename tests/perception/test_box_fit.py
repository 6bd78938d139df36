"""The derivatives of the fit, and the class priors."""

from dataclasses import replace

import numpy as np
from support.blocks import CAMERA

from eldenet.geometry import PinholeCamera
from eldenet.perception import box_fit
from eldenet.perception.priors import PRIORS, prior_of, silhouette


def test_the_gradient_is_the_derivative_of_the_cost():
    rng = np.random.default_rng(0)
    count, points = 6, 40
    direction = np.concatenate([rng.uniform(-0.4, 0.4, (count, points, 2)), np.ones((count, points, 1))], -1)
    problem = box_fit.Problem(
        direction, rng.uniform(8, 14, (count, points)), np.ones((count, points)),
        np.linspace(0.3, 10, count), np.full((count, 2), 0.4), np.linspace(0.6, 1, count),
        np.tile([250.0, 80, 330, 140], (count, 1)), np.full((count, 4), 4.0),
        rng.random((count, 4)) > 0.4, np.tile(silhouette("vehicle", "tight"), (count, 1, 1)),
        np.log(np.tile([3.9, 1.6, 1.5], (count, 1))), np.full((count, 3), 0.1),
        np.tile([1.6, 0.01, -0.02], (count, 1)),
        np.full(count, 0.1), np.full(count, 0.08),
    )  # fmt: skip
    state = np.tile([0.3, 10.0, 1.5, 0.4, *np.log([3.9, 1.6, 1.5]), 0.02], (count, 1)) + rng.normal(
        0, 0.05, (count, 8)
    )
    camera = PinholeCamera(CAMERA.intrinsics, np.eye(3), np.array([0.05, 0.02, 0.01]))
    model = box_fit.linearize(problem, camera, state)
    for unknown in range(box_fit.UNKNOWNS):
        step = np.zeros(box_fit.UNKNOWNS)
        step[unknown] = 1e-6
        high, low = (box_fit.linearize(problem, camera, state + sign * step).cost for sign in (1, -1))
        np.testing.assert_allclose(model.gradient[:, unknown], (high - low) / 2e-6, rtol=2e-3, atol=2e-3)


def test_priors_are_found_by_name_in_upper_and_lower_case():
    assert prior_of("Car") is prior_of("car") is PRIORS["car"]
    assert prior_of("gizmo") is None
    own = replace(PRIORS["car"], size=(3.6, 1.6, 1.5))
    assert prior_of("Pallet", PRIORS | {"Pallet": own}) is prior_of("pallet", {"Pallet": own}) is own
    assert prior_of("Car", PRIORS | {"Car": own}) is own
    for shape in ("vehicle", "upright", "box"):
        for style in ("tight", "projected"):
            assert np.abs(silhouette(shape, style)).max() == 0.5
