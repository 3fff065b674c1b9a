"""The policy's end of the pipes: imports the submitted file, then answers batches until the evaluator closes the pipe.

``evaluator.policy.sandbox.kernel`` calls it once the sandbox is set up. What the policy prints goes to the host's log;
questions and replies have pipes of their own.
"""

from __future__ import annotations

import importlib.util
import io
import os
import queue
import signal
import sys
import threading
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.policy.faults import PolicyFault, check_maps, form_fault
from evaluator.policy.wire import MAX_HEADER, REPLIES, TAGS, Frame, frame_parts, read_frame, read_question

_TRACEBACK_LINES = 12
_MESSAGE_CHARACTERS = 2000
_KIND_CHARACTERS = 200
_CAUSES = 10
_ANY_SIZE = 1 << 40

_ANALYTICS = ("openvino_telemetry",)
"""Modules that report the use of a library, and keep an identity under HOME; the library works without."""
_LOOKS_UP_VARIABLE = type(os.environ).__getitem__.__code__

__all__ = ["serve"]


class CannotLoad(Exception):
    """Why the policy cannot be used, in words for its author."""


def serve(request_fd: int, reply_fd: int, report: dict[str, Any]) -> None:
    """Report the sandbox, load the policy that the first question names, and answer the other questions.

    The report is sent before anything of the policy is read, so that the policy cannot change it.
    """
    _reply(reply_fd, {"op": "confined", **report})
    questions: queue.Queue[Frame] = queue.Queue()
    threading.Thread(target=_listen, args=(request_fd, questions), daemon=True).start()

    modules: dict[str, Any] = sys.modules
    modules.update(dict.fromkeys(_ANALYTICS))  # they count as not installed
    order, _ = questions.get()
    own_folder = str(Path(order["path"]).parent) + os.sep
    try:
        policy, tags = _load(order)
    except BaseException as error:
        _reply(reply_fd, {"op": "loaded", "ok": False, **_describe(error, own_folder)})
        return
    _reply(reply_fd, {"op": "loaded", "ok": True, **tags})
    while True:
        header, arrays = questions.get()
        if header["op"] == "close":
            return
        reply, answer = _answer(policy, tags["privileged"], header, arrays, own_folder)
        _reply(reply_fd, {"op": REPLIES[header["op"]], "number": header["number"], **reply}, answer)


def _listen(request_fd: int, questions: queue.Queue[Frame]) -> None:
    """Queue every question; when the evaluator has ended, end the whole process group."""
    try:
        with io.BufferedReader(io.FileIO(request_fd), 1 << 20) as stream:

            def read(count: int) -> bytearray:
                data = bytearray(count)
                if stream.readinto(data) != count:
                    raise EOFError
                return data

            op = ""
            while op != "close":
                question = read_frame(read, MAX_HEADER, _ANY_SIZE)
                op = question[0]["op"]
                questions.put(question)
    except BaseException:
        with suppress(OSError):
            os.killpg(0, signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)  # in the sandbox it may signal only itself


def _load(order: dict[str, Any]) -> tuple[Any, dict[str, bool]]:
    """The policy, and what its class says of itself."""
    path = Path(order["path"])
    sys.path[:0] = [str(path.parent), *([order["import_root"]] if order["import_root"] else [])]
    name = f"submitted_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise CannotLoad(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickles look their module up
    spec.loader.exec_module(module)
    kind = getattr(module, order["class_name"], None)
    if not isinstance(kind, type):
        found = [key for key, value in vars(module).items() if isinstance(value, type) and value.__module__ == name]
        raise CannotLoad(
            f"{path.name} has no class {order['class_name']}; it defines {', '.join(found) or 'no class'}: "
            f"name one as {path.name}:ClassName"
        )
    if not callable(getattr(kind, "act", None)):
        raise CannotLoad(f"class {order['class_name']} of {path.name} has no method act(observations)")
    checkpoint = None if order["checkpoint"] is None else Path(order["checkpoint"])
    policy = kind(checkpoint, order["device"])
    return policy, {tag: getattr(kind, tag, False) is True for tag in TAGS}


def _answer(
    policy: Any, privileged: bool, header: dict[str, Any], arrays: dict[str, Any], own_folder: str
) -> tuple[dict[str, Any], np.ndarray[Any, Any] | None]:
    """Ask the policy; the reply's header, and the answer where there is one."""
    batch, situations = read_question(header, arrays)
    try:
        if header["op"] == "maps":
            answer = np.asarray(_maps_of(policy)(batch), np.float32)
        elif privileged:
            answer = np.asarray(policy.act(batch, situations))
        else:
            answer = np.asarray(policy.act(batch))
    except BaseException as error:
        return {"ok": False, "reason": "exception", **_describe(error, own_folder)}, None
    fault = (check_maps if header["op"] == "maps" else form_fault)(answer, len(batch))
    if isinstance(fault, PolicyFault):
        return {"ok": False, "reason": fault.reason, "message": fault.detail, "where": ""}, None
    return {"ok": True}, answer


def _maps_of(policy: Any) -> Any:
    if not callable(getattr(policy, "maps", None)):
        raise CannotLoad(f"class {type(policy).__name__} has no method maps(observations)")
    return policy.maps


def _describe(error: BaseException, own_folder: str) -> dict[str, Any]:
    """What was raised, where in the submitter's code, and the last lines of the traceback from there on."""
    if isinstance(error, CannotLoad):
        return {"message": str(error), "where": "", "traceback": "", "kinds": [], "cause": {}}
    start = error.__traceback__
    while start is not None and start.tb_frame.f_code.co_filename.startswith((__file__, "<frozen importlib")):
        start = start.tb_next  # the frames of this file say nothing to a submitter
    where = ""
    if isinstance(error, SyntaxError) and error.filename:
        where = f"{error.filename}:{error.lineno}"
    for frame in traceback.extract_tb(start):
        if frame.filename.startswith(own_folder):
            where = f"{frame.filename}:{frame.lineno}"
    try:
        message, lines = f"{type(error).__name__}: {error}", traceback.format_exception(type(error), error, start)
    except Exception:
        message, lines = type(error).__name__, []
    return {
        "message": message[:_MESSAGE_CHARACTERS],
        "where": where,
        "traceback": "\n".join("".join(lines).splitlines()[-_TRACEBACK_LINES:])[:_MESSAGE_CHARACTERS],
        "kinds": _kinds(error),
        "cause": _cause(error),
    }


def _cause(error: BaseException) -> dict[str, Any]:
    """Of the first error in the chain that the sandbox may have caused: what the evaluator needs to explain it."""
    found: BaseException | None = error
    for _ in range(_CAUSES):
        system = isinstance(found, OSError) and found.errno is not None  # not one that a library raised in its name
        if found is None or system or isinstance(found, ImportError | MemoryError | KeyError):
            break
        found = found.__cause__ or found.__context__
    found = found or error
    last = found.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    module = "" if last is None else str(last.tb_frame.f_globals.get("__name__", ""))
    name = getattr(found, "name", None) if isinstance(found, ImportError) else None
    if isinstance(found, KeyError) and last is not None and last.tb_frame.f_code is _LOOKS_UP_VARIABLE:
        name = found.args[0]
    number, path = getattr(found, "errno", None), getattr(found, "filename", None)
    if isinstance(path, bytes):
        path = os.fsdecode(path)
    return {
        "kinds": [f"{kind.__module__}.{kind.__qualname__}"[:_KIND_CHARACTERS] for kind in type(found).__mro__],
        "number": number if isinstance(number, int) else 0,
        "path": path[:_MESSAGE_CHARACTERS] if isinstance(path, str) else "",
        "name": str(name or "")[:_KIND_CHARACTERS],
        "module": module[:_KIND_CHARACTERS],
        "text": _text(found)[:_KIND_CHARACTERS],
    }


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return ""


def _kinds(error: BaseException | None) -> list[str]:
    """Types of an exception and of its causes, with their bases: for some of them the evaluator knows a fix."""
    found: dict[str, None] = {}
    for _ in range(_CAUSES):
        if error is None:
            break
        found.update(
            (f"{kind.__module__}.{kind.__qualname__}"[:_KIND_CHARACTERS], None) for kind in type(error).__mro__
        )
        error = error.__cause__ or error.__context__
    return list(found)


def _reply(reply_fd: int, header: dict[str, Any], answer: np.ndarray[Any, Any] | None = None) -> None:
    arrays = {} if answer is None else {"answer": (answer, 1)}
    for part in frame_parts(header, arrays):
        view = memoryview(part)
        while view:
            view = view[os.write(reply_fd, view) :]
