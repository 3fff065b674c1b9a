"""From a path to a ``Run``: checks what a run folder or an entry must be."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

from evaluator.policy.named import is_adapted
from evaluator.run.audit import Audit
from evaluator.run.check import RunFiles, read_files
from evaluator.run.entry import read_entry
from evaluator.run.folder import being_written
from evaluator.run.header import RUN_FILE, environment_of, isolation_level, read_header, resume_command
from evaluator.run.run import AGAIN, Provenance, Run
from evaluator.run.seal import SUMMARY_FILE, results_name, sealed_names
from rema_data.errors import MissingFileError

__all__ = ["read_run"]

_WITHOUT_SEAL = 2
"""The last format of which there are finished runs without a seal."""


def read_run(path: Path, *, with_findings: bool = False) -> Run:
    """A run, from its folder or from its entry; see ``evaluator.read_run``.

    ``with_findings`` is for replays and submissions: the folder must be sealed, and a run that changed is returned with
    its ``findings``. Without it, such a run is an IntegrityError that names files, fields and rows.
    """
    if path.is_file():
        entry = read_entry(path)
        if with_findings:
            raise entry.no_folder()
        return entry
    if not (path / RUN_FILE).is_file() and not (path / SUMMARY_FILE).is_file():
        hint = "give the run folder of a `rema evaluate`" if path.is_dir() else "check the path"
        raise MissingFileError(f"{path} holds no finished run", hint=hint, path=str(path))
    header, payload = read_header(path)
    summed = (path / SUMMARY_FILE).is_file()
    if "seal" not in header and (with_findings or (summed and header["format"] > _WITHOUT_SEAL)):
        _refuse_unsealed(path, header)
    if not with_findings:
        if not summed:
            hint = f"finish it: {resume_command(header, path)}"
            raise MissingFileError(f"{path} holds no finished run: it has no {SUMMARY_FILE}", hint=hint, path=str(path))
        for name in sealed_names(header) if "seal" in header else [results_name(header)]:
            if not (path / name).is_file():
                raise MissingFileError(f"{path / name} does not exist", hint=AGAIN, path=str(path / name))
    run = _run(path, read_files(path, header, payload))
    if run.findings and not with_findings:
        raise run.refusal()
    return run


def _refuse_unsealed(folder: Path, header: dict[str, Any]) -> NoReturn:
    if being_written(folder):
        message = f"{folder} is not sealed yet: a process is writing in it"
        raise MissingFileError(message, hint="wait for its end", path=str(folder))
    raise MissingFileError(
        f"{folder} is not sealed: the run was interrupted, or made by a version of rema without seals",
        hint="run the command that made it again (with its --checkpoint, if it had one): it continues where it "
        f"stopped and writes what is missing\n{resume_command(header, folder)}",
        path=str(folder),
    )


def _run(folder: Path, files: RunFiles) -> Run:
    """What the files say; their findings are kept."""
    header, summary = files.header, files.summary or {}
    identity, policy, seal = header["identity"], header["policy"], header.get("seal", "")
    audit = summary.get("audit")
    return Run(
        source=folder,
        policy=policy.get("name", ""),
        privileged=policy.get("privileged", False),
        kind_of_policy="simulator" if policy.get("simulator") else "",
        adapted=policy.get("adapted", False) or is_adapted(policy.get("name", "")),
        task=identity["task"],
        split=identity["split"],
        protocol=identity["protocol"],
        provenance=Provenance(
            **{name: identity[name] for name in ("policy_digest", "protocol_hash", "scenarios_hash", "fingerprint")},
            environment=environment_of(header),
            seal=seal["sha256"] if isinstance(seal, dict) else seal,
        ),
        audit=None if audit is None else Audit(*(audit[field.name] for field in fields(Audit))),
        stopped_early=bool(summary.get("stopped_early")),
        unfinished=summary.get("unfinished", 0) if files.unfinished is None else files.unfinished,
        nondeterministic=summary.get("nondeterministic", 0),
        isolation=isolation_level(header) or "",
        findings=files.findings,
        files=files,
    )
