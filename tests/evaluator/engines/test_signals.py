"""Processes end by signals that Python has no name for, too."""

from __future__ import annotations

import os
import re
import signal

import pytest

from evaluator.engines.base import signal_name
from evaluator.engines.child import call_in_child
from rema_data.errors import InfrastructureError

ODD = signal.SIGRTMIN + 6 if hasattr(signal, "SIGRTMIN") else signal.SIGTERM


def end_oddly() -> None:
    os.kill(os.getpid(), ODD)


def test_every_signal_has_a_name() -> None:
    assert [signal_name(number) for number in (9, 11)] == ["SIGKILL", "SIGSEGV"]
    assert len({signal_name(number) for number in range(1, 65)}) == 64


def test_a_worker_that_ends_by_a_signal_without_a_name() -> None:
    with pytest.raises(InfrastructureError, match=re.escape(f"killed by {signal_name(ODD)}")):
        call_in_child("tests.evaluator.engines.test_signals:end_oddly")
