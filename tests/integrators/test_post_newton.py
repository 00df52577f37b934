"""Post-Newton steps: a contact in the documented style, by GeneralizedAlpha, by IDAS, by events."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from oracles import discontinuities as closed
from paths import MODELS
from scenes.events import dropped

import rbsd_sym as rs
from rbsd_sym import __main__ as command_line

MODEL = MODELS / "post_newton_contact.py"
TIMES = np.linspace(0, 1, 101)
PHASES = closed.spring_bounce_phases(1.0, 1, 1e4, 10, 9.81, 0.1)


@cache
def documented() -> rs.Model:
    return rs.compile_scene(command_line.load_model_file(MODEL).scene())


@cache
def by_events() -> rs.Model:
    """The same ball and floor with the contact as an effect."""
    return dropped(rs.Contact(2, 1e4, 10))


def height_error(run: rs.Trajectory) -> float:
    height, _ = closed.state_at(PHASES, run.t)
    return float(np.abs(run["ball.p_z"] - height).max())


def counter(returned: Any, start: float = 0.0, **more: Any) -> rs.Model:
    """A body on an oscillator whose data follow from `returned(t, data, displacement)`."""

    def post(mbs: Any, t: Any, item: Any, data: Any, u: Any, *rest: Any) -> Any:
        return returned(t, data, u)

    body = rs.RigidBody("body", 1, (1, 1, 1), position=(1, 0, 0))
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("body"), (1, 0, 0, 0, 0, 0), data=[start],
        post_newton_step=post, **more,
    )  # fmt: skip
    return rs.compile_scene(rs.Scene("counted", [body], [spring]))


def test_same_result_by_alpha_idas_and_events() -> None:
    exact = height_error(rs.simulate(by_events(), TIMES, rs.Idas(1e-10, 1e-12)))
    idas = height_error(rs.simulate(documented(), TIMES, rs.Idas(1e-9, 1e-11)))
    alpha = height_error(rs.simulate(documented(), TIMES, rs.GeneralizedAlpha(1e-3)))
    assert exact < 1e-9
    assert idas < 1e-8  # a change is known to an instant, so only the tolerance counts
    assert alpha < 5e-4  # h = 1 ms, where the contact's frequency is 100 rad/s


@pytest.mark.parametrize("model", [documented, by_events], ids=["post_newton", "events"])
def test_order_two_with_contacts(model: Any) -> None:
    """Both ways to switch keep the order: the switch is found, and the method starts again."""
    errors = [height_error(rs.simulate(model(), TIMES, rs.GeneralizedAlpha(h)))
              for h in (1e-3, 5e-4, 2.5e-4)]  # fmt: skip
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders - 2).max() < 0.15, orders


def test_contact_without_a_recommended_step_is_switched_within_one() -> None:
    """The step is solved again with the new data, but not cut: the switch is a step late or early.

    So the force is wrong for a share of a step, an error of order one; it is far larger.
    """
    k, d = 1e4, 10.0

    def force(mbs: Any, t: Any, item: Any, data: Any, u: Any, th: Any, v: Any, *rest: Any) -> Any:
        return [0, 0, data[0] * (k * u[2] + d * v[2]), 0, 0, 0]

    def post(mbs: Any, t: Any, item: Any, data: Any, u: Any, th: Any, v: Any, *rest: Any) -> Any:
        push = -(k * u[2] + d * v[2])
        touches = rs.where(u[2] < 0, rs.where(push > 0, 1, 0), 0)
        return [rs.where(touches == data[0], 0, abs(push)), -1, touches]

    ball = rs.RigidBody("ball", 1, (4e-4, 4e-4, 4e-4), position=(0, 0, 0.1))
    floor = rs.RigidBodySpringDamper(
        "floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0, data=[0.0], force=force,
        post_newton_step=post,
    )  # fmt: skip
    model = rs.compile_scene(rs.Scene("late", [ball], [floor], gravity=(0, 0, -9.81)))
    rough = rs.simulate(model, TIMES, rs.GeneralizedAlpha(1e-3))
    fine = rs.simulate(documented(), TIMES, rs.GeneralizedAlpha(1e-3))
    assert rough.stats["rejected_steps"] == 0
    assert fine.stats["rejected_steps"] > 10
    assert height_error(rough) > 3 * height_error(fine)


def test_data_become_what_is_returned() -> None:
    """Without error: the data of each accepted step, the time of its end here."""
    model = counter(lambda t, data, u: [0, -1, t])
    run = rs.simulate(model, np.linspace(0, 1, 11), rs.GeneralizedAlpha(0.1))
    assert np.abs(run["spring.data_0"] - run.t).max() < 1e-15
    assert run.stats["steps"] == 10
    watched = rs.simulate(model, np.linspace(0, 1, 11), rs.Idas())
    assert np.abs(watched["spring.data_0"] - watched.t).max() < 1e-15
    assert watched["body.p_x"][-1] == pytest.approx(np.cos(1), abs=1e-7)


def test_a_step_is_solved_again_until_the_error_is_small() -> None:
    """data -> (data + u) / 2 converges to u at the end of the step, by halves."""

    def halves(t: Any, data: Any, u: Any) -> Any:
        return [abs(u[0] - data[0]), -1, (data[0] + u[0]) / 2]

    rough = rs.PostNewton(tolerance=1e-3, iterations=20)
    integrator = rs.GeneralizedAlpha(0.1, post_newton=rough)
    run = rs.simulate(counter(halves, 1.0), np.linspace(0, 1, 11), integrator)
    assert run.stats["rejected_steps"] == 0
    assert 0 < np.abs(run["spring.data_0"] - run["body.p_x"])[1:].max() < 1e-3
    bounded = rs.GeneralizedAlpha(0.1, post_newton=rs.PostNewton(1e-3, iterations=2))
    cut = rs.simulate(counter(halves, 1.0), np.linspace(0, 1, 11), bounded)
    assert cut.stats["rejected_steps"] > 0  # twice is not enough for a change of 0.1 in a step
    assert np.abs(cut["spring.data_0"] - cut["body.p_x"])[1:].max() < 1e-3


def test_recommended_steps() -> None:
    """While there is no error a wish bounds the next step: here 0.01 s, from t = 0.5 on."""
    model = counter(lambda t, data, u: [0, rs.where(t > 0.4999, 0.01, -1), data[0]])
    run = rs.simulate(model, np.linspace(0, 1, 11), rs.GeneralizedAlpha(0.1))
    assert run.stats["rejected_steps"] == 0
    assert run.stats["steps"] == 5 + 50
    once = counter(lambda t, data, u: [1 - data[0], 0, rs.where(t > 0.5, 1, data[0])], 0.0)
    with pytest.raises(rs.IntegrationError):  # an error that nothing resolves: the smallest steps
        rs.simulate(once, [0, 1], rs.GeneralizedAlpha(0.1, max_steps=1000))


def test_error_that_stays_ends_with_the_smallest_step() -> None:
    """An error that data do not mend cuts the step to a millionth, and is then accepted."""
    model = counter(lambda t, data, u: [rs.where(data[0] < 3, 1, 0), -1, data[0] + 1])
    method = rs.GeneralizedAlpha(0.1, post_newton=rs.PostNewton(iterations=1))
    run = rs.simulate(model, np.linspace(0, 1, 11), method)
    assert run.outcome is rs.Outcome.reached_end
    assert run.stats["rejected_steps"] > 10
    assert run["spring.data_0"][-1] >= 3


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rs.PostNewton(tolerance=-1), "PostNewton: tolerance -1"),
        (lambda: rs.PostNewton(iterations=0), "PostNewton: iterations 0"),
        (lambda: rs.simulate(documented(), 1.0, rs.Rosenbrock()), "use GeneralizedAlpha"),
        (lambda: rs.simulate(documented(), 1.0, rs.Dop853()), "Dop853 does not support"),
        (lambda: rs.simulate(documented(), 1.0, rs.RK4(1e-3)), "RK4 does not support"),
        (lambda: rs.simulate(by_events(), 1.0, rs.Collocation(1e-3)), "events, which Collocation"),
    ],
)
def test_bad_calls(call: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()
