"""Valid and invalid answers to one batch."""

from __future__ import annotations

import numpy as np
import pytest

from evaluator.policy import PolicyFault, PolicyHost, PolicyLimits, resolve
from evaluator.policy.faults import FaultReason, check_answer
from rema_data import grid
from rema_data.errors import InputError

from .batches import make_batch, make_situation
from .conftest import WritePolicy

LIMITS = PolicyLimits(start_s=120, batch_s=30)


def reasons(answers: list[int | PolicyFault]) -> list[str]:
    return [answer.reason if isinstance(answer, PolicyFault) else "ok" for answer in answers]


@pytest.mark.parametrize("dtype", ["int64", "int32", "uint16"])
def test_cells_and_indices_mean_the_same(dtype: str) -> None:
    valid = make_batch(2).valid
    cells = np.array([[30, 31, 2], [4, 59, 15]], dtype)
    indices = grid.encode(cells[:, 0].astype(int), cells[:, 1].astype(int), cells[:, 2].astype(int)).astype(dtype)
    expected = [int(index) for index in indices]
    assert check_answer(cells, valid) == expected
    assert check_answer(indices, valid) == expected


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (np.zeros((3, 3), int), FaultReason.SHAPE),
        (np.zeros((2, 2), int), FaultReason.SHAPE),
        (np.array(5), FaultReason.SHAPE),
        (np.full((2, 3), 30.0), FaultReason.DTYPE),
        (np.full(2, True), FaultReason.DTYPE),
        (np.full((2, 3), np.nan), FaultReason.NAN),
        (np.full(2, -1), FaultReason.RANGE),
        (np.full(2, 65536), FaultReason.RANGE),
        (np.full((2, 3), 64), FaultReason.RANGE),
        (np.full((2, 3), [30, 31, -1]), FaultReason.RANGE),
        (np.full((2, 3), 2), FaultReason.INVALID),
        (np.full(2, 0), FaultReason.INVALID),
        (np.full(2, 2**64 - 1, np.uint64), FaultReason.RANGE),
    ],
)
def test_unusable_answers_are_faults(answer: np.ndarray, reason: FaultReason) -> None:
    assert reasons(check_answer(answer, make_batch(2).valid)) == [reason] * 2


def test_one_bad_action_is_one_fault(write_policy: WritePolicy) -> None:
    spec = write_policy("good[1] = [0, 0, 0]\ngood[2] = [99, 0, 0]\nreturn good")
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        answers = host.act(make_batch(4))
        assert reasons(answers) == ["ok", "invalid_action", "out_of_range", "ok"]
        assert answers[0] == grid.encode(30, 31, 2)
        assert not host.privileged
        assert reasons(host.act(make_batch(3)))[:2] == ["ok", "invalid_action"]
        assert host.act(make_batch(0)) == []


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        ("return good[:, :2]", "wrong_shape"),
        ("return None", "wrong_shape"),
        ("return good * 1.0", "wrong_dtype"),
        ("return np.full((n, 3), np.nan)", "nan"),
        ("return np.full((n, 3), 'x')", "wrong_dtype"),
    ],
)
def test_a_bad_return_value_is_a_fault_of_the_batch(write_policy: WritePolicy, act: str, reason: str) -> None:
    with PolicyHost(write_policy(act), None, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(2))) == [reason] * 2
        assert host.restarts == 0


def test_the_policy_sees_what_was_given_and_nothing_else(write_policy: WritePolicy) -> None:
    spec = write_policy(
        """
        assert observations.scene.dtype == observations.end_effector.dtype == np.float32
        assert observations.scene.shape == (n, 64, 64) and observations.end_effector.shape == (n, 112, 112, 4)
        assert observations.valid.shape == (n, 64, 64, 16) and observations.valid.dtype == bool
        assert observations.valid[-1, 4, 4, 0] and not observations.valid[-1, 3, 3, 0]
        assert observations.end_effector[-1, 50, 40, 1] == 1 and abs(observations.scene[2, 0, 0] - 2e-4) < 1e-9
        assert (observations.task, observations.step) == ("grasp", 0)
        assert (observations.primitive, observations.embodiment) == ("grasp", "gripper")
        assert "pybullet" not in sys.modules and "SECRET" not in os.environ and not os.listdir(".")
        observations.scene[:] = 0; observations.valid[:] = False  # its own copies, to do with as it likes
        return good
        """
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SECRET", "scenario 7")
        with PolicyHost(spec, None, "cpu", LIMITS) as host:
            batch = make_batch(3)
            assert reasons(host.act(batch, (make_situation(),) * 3)) == ["ok"] * 3
            assert batch.valid.any()


def test_only_a_privileged_policy_gets_the_situations() -> None:
    with PolicyHost(resolve("scripted"), None, "cpu", LIMITS) as host:
        assert host.privileged
        answer = host.act(make_batch(1), (make_situation(0.02, -0.03),))[0]
        assert isinstance(answer, int)
        x_m, y_m, _ = grid.to_world(answer)
        assert abs(x_m - 0.02) <= grid.PIXEL_M / 2 and abs(y_m + 0.03) <= grid.PIXEL_M / 2
        with pytest.raises(InputError):
            host.act(make_batch(1))


@pytest.mark.parametrize("act", ["return good.tolist()", "return Tensor(good)"])
def test_lists_and_tensors_are_answers(write_policy: WritePolicy, act: str) -> None:
    top = """
    class Tensor:
        def __init__(self, data): self.data = data
        def __array__(self, dtype=None, copy=None): return self.data
    """
    with PolicyHost(write_policy(act, top=top), None, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]
