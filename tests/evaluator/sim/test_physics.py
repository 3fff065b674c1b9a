"""What the world must do: hold tools, see forbidden touches, and give the same bits after any earlier step."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from evaluator.sim.attempt import Attempt, Hand
from evaluator.sim.kinds import kind_of
from evaluator.sim.kinds.tool_push import ToolPush
from evaluator.sim.kinematics import solve_path
from evaluator.sim.motion import JointPath
from evaluator.sim.parameters import WORLD, parameters_hash
from evaluator.sim.reach import valid_actions
from evaluator.sim.reference import reference_step
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data import grid
from rema_data.schema import (
    TASKS,
    Failure,
    Grip,
    ObjectSpec,
    Placement,
    Scenario,
    Shape,
    Situation,
    StepOutcome,
    to_dict,
)
from tests.evaluator.sim.conftest import BAR, ELL, HEIGHT, STICK, TEE, held


def shake(simulator: Simulator, rng: np.random.Generator) -> tuple[float, float]:
    """Hold a bar of 0.1 kg and move it 10 cm to and fro for 5 s; returns slip (m) and turn (rad) in the hand."""
    spec = ObjectSpec(Shape.I, 0.100 / (WORLD.density_kg_m3 * HEIGHT * 0.045), 0.045, 0.0, HEIGHT)
    grip = held(spec, along_m=float(rng.uniform(-0.1, 0.1)) * spec.length_m)
    world = simulator.world
    world.begin(("left",))
    target = world.place(BAR, 0.0, -0.6, HEIGHT / 2, 0.0)
    situation = Situation("grasp_push", 1, Placement(BAR, 0.0, -0.6, 0.0), (grip,))
    hand = Hand(world.arms["left"], grip)
    attempt = Attempt(world, situation, [hand], target, (), (hand.arm.body,))
    time = np.arange(5 * 120 + 1) / 120
    swing = 0.10 * np.sin(2 * np.pi * 0.8 * time) * np.clip(time, 0, 1)
    yaw = float(rng.uniform(0, 2 * np.pi))
    heading = float(rng.uniform(0, 2 * np.pi))
    x, y = swing * math.cos(heading), swing * math.sin(heading)
    joints = solve_path(hand.arm.base, x, y, np.full(x.shape, 0.15), np.full(x.shape, yaw), False)
    hand.arm.reset(joints[0], grip.opening_m)
    ToolPush().take(attempt, (0.0, 0.0, yaw), 0.15)
    before = attempt.grip_in_hand(hand)
    path = JointPath(joints, np.diff(joints, axis=0) * 120)
    for target in path.targets():
        hand.arm.follow(*target)
        attempt.step(WORLD.control_every)
    after = attempt.grip_in_hand(hand)
    return math.dist(before[:3], after[:3]), abs(after[3] - before[3])


def hold_all(simulator: Simulator, times: int) -> None:
    rng = np.random.default_rng(5)
    slips = np.array([shake(simulator, rng) for _ in range(times)])
    assert slips[:, 0].max() < 2e-3, slips[:, 0].max()
    assert slips[:, 1].max() < math.radians(2)


def test_a_shaken_bar_stays_in_the_hand(simulator: Simulator) -> None:
    hold_all(simulator, 15)


@pytest.mark.slow
def test_a_hundred_shaken_bars_stay_in_the_hand(simulator: Simulator) -> None:
    hold_all(simulator, 100)


def test_a_centred_grasp_lifts(simulator: Simulator) -> None:
    outcome = simulator.run(
        Situation("grasp", 0, Placement(BAR, 0.02, -0.03, 0.0)), int(grid.snap(0.02, -0.03, np.pi / 2))
    )
    assert outcome.success
    assert outcome.failure is None
    assert outcome.lift_m > WORLD.grasp_success_lift_m
    assert outcome.grip is None  # nothing follows in this task


def test_a_pick_reports_the_tool_in_the_hand(simulator: Simulator) -> None:
    action = int(grid.snap(0.02, -0.03, np.pi / 2))
    outcome = simulator.run(Situation("grasp_push", 0, Placement(BAR, 0.02, -0.03, 0.0)), action)
    assert outcome.success
    grip = outcome.grip
    assert grip is not None
    assert grip.spec == BAR
    assert grip.opening_m == pytest.approx(BAR.width_m, abs=2e-3)
    assert grip.z_m == pytest.approx(HEIGHT / 2 - WORLD.grasp_height_m, abs=3e-3)
    assert abs(math.sin(grip.yaw_rad)) == pytest.approx(1.0, abs=0.02)


def test_landing_on_the_object_ends_the_attempt(simulator: Simulator) -> None:
    across = simulator.run(
        Situation("grasp", 0, Placement(replace(BAR, length_m=0.13), 0, 0, 0.0)), int(grid.snap(0, 0, 0))
    )
    assert across.failure is Failure.BLOCKED
    assert across.peak_force_n > WORLD.stop_force_n
    on_top = simulator.run(Situation("push", 0, Placement(BAR, 0.0, 0.0, 0.0)), int(grid.snap(0.0, 0.0, 0.0)))
    assert on_top.failure is Failure.BLOCKED


def test_a_push_from_behind_moves_it_and_a_push_beside_does_not(simulator: Simulator) -> None:
    situation = Situation("push", 0, Placement(TEE, 0.05, 0.0, 0.4))
    hit = simulator.run(situation, int(grid.snap(-0.05, 0.0, 0.0)))
    assert hit.success
    assert hit.displacement_m >= WORLD.push_success_m
    miss = simulator.run(situation, int(grid.snap(-0.05, -0.11, 0.0)))
    assert miss.failure is Failure.MISSED
    assert miss.displacement_m == 0.0


def test_a_finger_on_the_target_of_a_tool_is_illegal(simulator: Simulator) -> None:
    """The tool stands behind the hand, so the fingers meet the target first."""
    grip = held(BAR, along_m=0.0, yaw_rad=0.0)
    grip = replace(grip, x_m=0.0, opening_m=BAR.length_m)
    sideways = Situation("grasp_push", 1, Placement(TEE, 0.08, 0.0, 0.0), (grip,))
    outcome = simulator.run(sideways, int(grid.snap(-0.06, 0.0, 0.0)))
    assert outcome.failure is Failure.ILLEGAL_CONTACT
    assert outcome.illegal_steps == 1
    ahead = Situation("grasp_push", 1, Placement(TEE, 0.08, 0.0, 0.0), (held(BAR, along_m=0.02),))
    assert simulator.run(ahead, int(grid.snap(-0.06, 0.0, 3 * np.pi / 2))).success


def test_two_sticks_pick_up_a_bar(simulator: Simulator) -> None:
    grips = (held(STICK), held(STICK))
    situation = Situation("grasp_grasp_push", 2, Placement(BAR, 0.0, 0.0, np.pi / 2), grips)
    outcome = simulator.run(situation, int(grid.snap(0.0, 0.0, 0.0)))
    assert outcome.success, outcome
    assert outcome.arm == "both"
    assert outcome.pinch is not None
    assert outcome.pinch.left_m == pytest.approx(outcome.pinch.right_m, abs=2e-3)
    assert abs(outcome.pinch.yaw_rad) == pytest.approx(np.pi / 2, abs=0.1)

    free = Situation("grasp_grasp_push", 3, Placement(BAR, 0.10, 0.0, np.pi / 2), (held(STICK),) * 2, outcome.pinch)
    assert simulator.run(free, int(grid.snap(-0.02, 0.0, np.pi / 2))).success


def test_out_of_reach_is_an_outcome(simulator: Simulator) -> None:
    situation = Situation("grasp_grasp", 2, Placement(BAR, 0, 0, 0), (held(STICK), held(STICK)))
    assert simulator.run(situation, grid.encode(30, 30, 12)).failure is Failure.UNREACHABLE


def test_nothing_succeeds_without_moving(simulator: Simulator) -> None:
    """No target starts lifted or displaced: an action that touches nothing never succeeds, simulated or not."""
    honest = Simulator(shortcuts=False)
    for task, steps in TASKS.items():
        last = len(steps) - 1
        grips = (held(STICK),) * (2 if steps[last].embodiment.two_arms else task == "grasp_push")
        if task == "grasp_grasp_push":
            continue
        target = Placement(BAR, 0.10, 0.10, 0.0)
        valid = np.argwhere(valid_actions(task, last))
        far = valid[np.argmax(np.abs(valid[:, :2] - [54, 54]).sum(axis=1))]
        outcome = honest.run(Situation(task, last, target, grips), int(grid.encode(*far)))
        assert outcome.failure is Failure.MISSED, (task, outcome)
        assert abs(outcome.displacement_m) < 1e-3
        assert outcome.lift_m < 1e-3
    honest.close()


def situations(count: int) -> list[tuple[Situation, int]]:
    """Situations of the four published tasks with random actions that mostly touch something."""
    picker = Simulator()
    made = []
    for index in range(count):
        for task in TASKS:
            if task == "grasp_grasp_push":
                continue
            rng = episode_generator(7, "calibrate", task, index)
            scenario = Scenario(task, "calibrate", index, draw_episode(rng, task))
            situation = scenario.first_situation()
            while not situation.last and (outcome := reference_step(picker, situation, rng)) is not None:
                situation = scenario.next_situation(situation, outcome)
            if situation.last:
                yaw = float(rng.integers(8)) * 2 * np.pi / 16
                made.append((situation, int(grid.snap(*kind_of(situation).aim(situation.target), yaw))))
    picker.close()
    return made


def digest(outcomes: list[StepOutcome]) -> str:
    return hashlib.sha256(json.dumps([to_dict(outcome) for outcome in outcomes]).encode()).hexdigest()


def fresh_digest(count: int) -> str:
    made = situations(count)
    simulator = Simulator()
    result = digest([simulator.run(*job) for job in made])
    simulator.close()
    return result


def test_same_bits_in_any_order_and_in_a_fresh_process(simulator: Simulator) -> None:
    count = 8
    jobs = situations(count)
    forward = [simulator.run(*job) for job in jobs]
    backward = [simulator.run(*job) for job in reversed(jobs)][::-1]
    assert forward == backward
    assert [simulator.run(*job) for job in jobs] == forward
    code = f"from tests.evaluator.sim.test_physics import fresh_digest; print(fresh_digest({count}))"
    fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert fresh.stdout.split()[-1] == digest(forward)


def test_earlier_steps_change_nothing(simulator: Simulator) -> None:
    """A long and varied history leaves no trace."""
    jobs = situations(4)
    before = [simulator.run(*job) for job in jobs]
    for job in situations(10)[16:]:
        simulator.run(*job)
    assert [simulator.run(*job) for job in jobs] == before


def test_shortcuts_give_the_same_labels(simulator: Simulator) -> None:
    honest = Simulator(shortcuts=False)
    rng = np.random.default_rng(11)
    skipped = 0
    for situation, _ in situations(6):
        valid = np.flatnonzero(valid_actions(situation.task, situation.step))
        action = int(valid[rng.integers(len(valid))])
        quick = simulator.run(situation, action)
        if quick.sim_steps == 0 and quick.failure is Failure.MISSED:
            skipped += 1
            assert honest.run(situation, action).failure is Failure.MISSED
        else:
            assert honest.run(situation, action) == quick
    assert skipped > 3
    honest.close()


def test_every_constant_is_in_the_hash() -> None:
    assert parameters_hash(replace(WORLD, hold_steps=WORLD.hold_steps + 1)) != parameters_hash(WORLD)
    assert parameters_hash(replace(WORLD)) == parameters_hash(WORLD)


def test_tools_are_held_where_they_were(simulator: Simulator) -> None:
    grip = Grip(ELL, 0.0, 0.01, 0.010, 1.57, ELL.width_m)
    situation = Situation("grasp_push", 1, Placement(BAR, 0.1, 0.1, 0.0), (grip,))
    outcome = Simulator(shortcuts=False).run(situation, int(grid.snap(-0.12, -0.12, 0.0)))
    assert outcome.failure is Failure.MISSED
