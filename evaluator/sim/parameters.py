"""Every physical constant of the world, in one frozen record that is hashed into the protocol.

What the paper fixes is marked (paper); the rest is calibrated against its random and scripted rates
(``benchmarks/calibrate.py``, ``docs/calibration.md``). Changing a value after a release is a new protocol version.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WorldParameters:
    """Constants of the world, SI units, world frame unless said otherwise."""

    # Solver
    time_step_s: float = 1 / 240
    solver_iterations: int = 50
    control_every: int = 2  # simulation steps between two joint targets
    gravity_m_s2: float = -9.81

    # Layout: two bases 1 m apart (paper), facing each other along y and raised above the table
    base_y_m: float = 0.5
    base_z_m: float = 0.30
    # The one deviation from the real arm: its joint 4 stops at 120 degrees, but hands here work as close as 0.22 m to
    # a base, where the elbow must fold further. All other limits are the real ones.
    joint4_limit_rad: float = 2.356
    joint_margin_rad: float = 0.01
    arm_force: float = 300.0  # N m, every joint
    arm_gain: float = 0.3

    # Hand: WSG-50. The tool centre point lies between the fingertips, tcp_offset_m below the frame of arm link 7.
    tcp_offset_m: float = 0.1985
    finger_lateral_m: float = 0.02
    finger_thickness_m: float = 0.010
    finger_length_m: float = 0.057
    finger_mass_kg: float = 0.10
    opening_max_m: float = 0.110
    finger_force_n: float = 30.0  # each
    finger_speed_m_s: float = 0.15
    finger_still_m_s: float = 0.01  # jaws slower than this have closed
    empty_opening_m: float = 0.002  # jaws closed this far hold nothing
    gear_erp: float = 0.2
    gear_force_n: float = 1000.0

    # Objects: I, L, T equally often; two random scales, along the bar and across it (paper: "scaled in 2 axes")
    length_min_m: float = 0.07
    length_max_m: float = 0.13
    width_min_m: float = 0.020
    width_max_m: float = 0.045
    arm_ratio: float = 0.86  # second bar of L and T over the main bar's length, its width included
    object_height_m: float = 0.030
    density_kg_m3: float = 500.0

    # Sticks of the two-arm tasks are longer, so that the wrists of two arms side by side keep clear of each other
    stick_length_min_m: float = 0.18
    stick_length_max_m: float = 0.205
    stick_width_min_m: float = 0.020
    stick_width_max_m: float = 0.035

    # Spawn rectangle of the centre of mass; yaw is uniform
    grasp_spawn_half_m: float = 0.108
    push_spawn_x_min_m: float = -0.02
    push_spawn_x_max_m: float = 0.11
    push_spawn_half_y_m: float = 0.11

    # Friction: Bullet multiplies the two coefficients of a contact
    finger_friction: float = 1.7
    object_friction: float = 0.38
    table_friction: float = 0.46
    finger_spinning_friction: float = 0.01

    # Motion
    free_speed_m_s: float = 0.5
    descend_speed_m_s: float = 0.5
    lift_speed_m_s: float = 0.5
    push_speed_m_s: float = 1.0
    tool_push_speed_m_s: float = 0.36
    ramp_share: float = 0.2  # share of a motion's time spent in each ramp of the trapezoid
    approach_clearance_m: float = 0.010  # a simulated descent starts this far above the object
    stop_force_n: float = 30.0  # protective stop of the descent
    grasp_height_m: float = 0.005  # of the tool centre point
    push_height_m: float = 0.005
    tool_clearance_m: float = 0.004  # of a held tool's lowest point above the table
    lift_height_m: float = 0.30  # (paper) of a single hand
    push_distance_m: float = 0.30  # (paper)
    scripted_push_offset_m: float = 0.095
    lost_steps: int = 12  # without contact: a lifted object is lost for good
    slip_lift_m: float = 0.01  # an object lost above this height slipped, below it was not lifted
    hold_steps: int = 60
    grip_settle_steps: int = 12  # after a held tool is put back into a hand
    settle_steps: int = 120  # at most
    rest_speed_m_s: float = 0.005

    # Two-stick pincer
    pair_open_m: float = 0.038  # from the pair's origin to each stick's tip, open
    pair_empty_m: float = 0.005  # likewise, where a closing has met nothing and stops: wrists must not meet
    pair_contact_n: float = 5.0  # both sticks feel the target
    pair_squeeze_steps: int = 40  # between contact and lift
    pair_lost_steps: int = 48
    pair_closing_speed_m_s: float = 0.12  # each arm
    pair_squeeze_n: float = 20.0
    pair_gain_m_per_n: float = 2e-5  # integrator of the squeeze, per control tick
    pair_max_correction_m: float = 5e-4  # per control tick
    pair_clearance_m: float = 0.006
    pair_lift_height_m: float = 0.12  # as high as both arms reach together (see joint4_limit_rad)
    pair_lift_speed_m_s: float = 0.35
    pinched_clearance_m: float = 0.010  # of a pinched object above the table while it pushes
    pinched_push_speed_m_s: float = 0.3

    # What counts
    grasp_success_lift_m: float = 0.20
    pair_success_lift_m: float = 0.10
    push_success_m: float = 0.10  # (paper)
    max_tool_slip_m: float = 0.02
    max_tool_turn_rad: float = 0.35
    max_tool_tilt_rad: float = 0.20
    max_speed_m_s: float = 10.0
    max_distance_m: float = 2.0


WORLD = WorldParameters()
"""The world of this protocol version."""


def parameters_hash(parameters: WorldParameters = WORLD) -> str:
    """sha256 (hex) of every constant, by name."""
    text = json.dumps(dataclasses.asdict(parameters), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
