"""The compiled step of shipped cases against a network of matrices in numpy that knows none of its code
(tests/helpers/campaigns/step_network.py)."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns import step_run
from campaigns.step_network import assembled, network, numpy_commands, our_commands
from portfolio import parametrize_first

from rths_cli.experiment.model_choice import Memory

SAME = 1e-12  # of the largest command
FIRST, STEPS = 2000, 4000


@parametrize_first(1, "case", ["el_centro_low_ff", "el_centro_low_ff_fb", "hachinohe_low_ff", "hachinohe_low_ff_fb"])
def test_the_commands_of_a_shipped_case_are_those_of_matrices(case: str, memory: Memory) -> None:
    """With all defaults: the feedforward counters the specimen's reaction by matrices and friction by its formula."""
    setup, blocks = step_run.prepared(memory, case)
    ground = np.ascontiguousarray(step_run.inputs(setup, blocks).drive[FIRST : FIRST + STEPS])
    parts = network(setup, blocks)
    assert any(part.added for part in parts) and any("corrected_2" in part.inputs for part in parts if part.added)
    ours = our_commands(parts, blocks, ground)()
    np.testing.assert_allclose(ours, numpy_commands(parts, ground), rtol=0.0, atol=SAME * np.abs(ours).max())


@pytest.mark.campaign
def test_the_assembled_loop_is_the_network(memory: Memory) -> None:
    """One matrix for the whole closed loop without what is added against friction gives the same commands."""
    setup, blocks = step_run.prepared(memory, "el_centro_low_ff_fb")
    linear = blocks.linearised()
    ground = np.ascontiguousarray(step_run.inputs(setup, blocks).drive[FIRST : FIRST + STEPS])
    parts = network(setup, linear)
    a, b, c, d = assembled(parts)
    state, commands = np.zeros(len(a)), np.zeros(STEPS)
    for k, row in enumerate(ground):
        commands[k] = (c @ state + d @ row)[0]
        state = a @ state + b @ row
    np.testing.assert_allclose(
        our_commands(parts, linear, ground)(), commands, rtol=0.0, atol=1e-9 * abs(commands).max()
    )
