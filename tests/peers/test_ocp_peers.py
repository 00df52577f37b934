"""The runner of rockit (optional) solves the problems that rbsd_sym solves; speed is not judged."""

from __future__ import annotations

import pytest

pytest.importorskip("rockit")

from charts import ocp_peers

from rbsd_sym.ocp import Ipopt


@pytest.mark.parametrize("name", ["effort", pytest.param("turn", marks=pytest.mark.slow)])
def test_rockit_has_the_same_program_and_cost(name: str) -> None:
    theirs, ours = ocp_peers.theirs(name, False, 1), ocp_peers.ours(name, Ipopt(), False, 1)
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-6)
    free = 0 if name == "effort" else ocp_peers.INTERVALS[name] + 1  # copies of the horizon
    assert abs(ours.variables - free - theirs.variables) <= 1
