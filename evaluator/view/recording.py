"""One episode as a recording for Rerun: maps, the action, and the objects on their way, step after step.

Needs rerun-sdk, which is the extra ``rerun``. Timelines: ``step`` counts from 1; ``time`` is simulated seconds.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD
from evaluator.sim.shapes import boxes
from evaluator.view.source import takes
from evaluator.view.viewer import Viewer
from rema_data.errors import InputError
from rema_data.interrupts import check
from rema_data.leftovers import temporary_folder
from rema_data.progress import Progress, Silent
from rema_data.repair import install
from rema_data.schema import HEIGHT_STEP_M, Action
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from evaluator.render.film import Take
    from evaluator.view.source import Seen

__all__ = ["write_recording"]

_ABOVE_M = 0.06
"""An arrow that shows an action lies so high above the table."""
_YAW_M = 0.04
_ACTION = (217, 119, 6)


def write_recording(viewer: Viewer, name: str, path: Path, progress: Progress | None = None) -> int:
    """Write the recording of an episode; gives its number of steps. It ends where the episode does, played again here.

    Raises
    ------
    InputError
        There is no such episode, no step of it can be played, the file is not to be an RRD file, or rerun-sdk is not
        installed.
    IntegrityError, MissingFileError, StorageError
        As everywhere; no file is written.
    """
    if path.suffix.lower() != ".rrd":
        raise InputError(
            f"{path} is not a file of Rerun", hint=f"write --rrd {path.with_suffix('.rrd')}", path=str(path)
        )
    try:
        import rerun
    except ImportError as error:
        raise InputError("recordings need rerun-sdk, which is not installed", hint=install("rema[rerun]")) from error
    from evaluator.render.film import SHOT_EVERY, FilmMaker

    progress = progress or Silent()
    place = viewer.place(name)
    steps = [step for step in viewer.source.steps(place) if step.row["action"] is not None]
    if not steps:
        raise InputError(f"no step of {name} has an action", hint="choose another episode")
    told = {step["step"]: step for step in viewer.episode(name)["steps"]}
    stream = rerun.RecordingStream("rema view", recording_id=f"{viewer.source.identity} {name}", send_properties=False)
    with temporary_folder("rema-rerun-") as folder, FilmMaker() as films:
        stream.save(folder / "episode.rrd")
        seconds = 0.0
        progress.phase("record", len(steps))
        recorded = 0
        for step, take in takes(viewer.source, place, steps, films, progress):
            stream.set_time("step", sequence=step.number + 1)
            stream.set_time("time", duration=seconds)
            _log_maps(rerun, stream, viewer.seen(name, step.number))
            _log_action(rerun, stream, take)
            said = told[step.number]
            lines = [f"# {said['title']}", said["action"], said["why"] or "success", said["measured"] or ""]
            stream.log("step", rerun.TextDocument("\n\n".join(lines), media_type="text/markdown"))
            for shot in (take.before, *take.shots):
                stream.set_time("time", duration=seconds)
                _log_objects(rerun, stream, shot)
                seconds += SHOT_EVERY * WORLD.time_step_s
            recorded += 1
            check()
            progress.advance(1)
        stream.flush()
        stream.disconnect()
        write_atomic(path, (folder / "episode.rrd").read_bytes())
    return recorded


def _log_maps(rerun: Any, stream: Any, seen: Seen) -> None:
    """Height maps in metres and masks, with y upwards as in every other picture."""
    maps = seen.observation
    meter = 1 / HEIGHT_STEP_M
    stream.log("scene", rerun.DepthImage(maps.scene[::-1], meter=meter))
    for state in range(2):
        stream.log(f"end_effector/state_{state + 1}/depth", rerun.DepthImage(maps.depth[state, ::-1], meter=meter))
        mask = maps.mask[state, ::-1].astype("uint8")
        stream.log(f"end_effector/state_{state + 1}/mask", rerun.SegmentationImage(mask))


def _log_action(rerun: Any, stream: Any, take: Take) -> None:
    """Arrows for the yaw of an action, and for the way of a push."""
    x_m, y_m, yaw_rad = Action(take.action).pose
    vectors = [(_YAW_M * math.cos(yaw_rad), _YAW_M * math.sin(yaw_rad), 0.0)]
    way_m = KINDS[take.situation.kind].reach_shifts(WORLD)[-1]
    if way_m:
        vectors.append((way_m, 0.0, 0.0))
    origins = [(x_m, y_m, _ABOVE_M)] * len(vectors)
    stream.log("world/action", rerun.Arrows3D(origins=origins, vectors=vectors, colors=[_ACTION] * len(vectors)))


def _log_objects(rerun: Any, stream: Any, shot: Any) -> None:
    """The objects of a moment, each as its boxes; what is gone is cleared."""
    from evaluator.render.colours import COLOURS
    from evaluator.render.studio import about_z

    stream.log("world/objects", rerun.Clear(recursive=True))
    for number, body in enumerate(shot.bodies):
        where = f"world/objects/{body.role}_{number}"
        parts = boxes(body.spec)
        stream.log(
            where,
            rerun.Transform3D(translation=body.position, quaternion=rerun.Quaternion(xyzw=body.quaternion)),
            rerun.Boxes3D(
                centers=[(part.x, part.y, 0.0) for part in parts],
                half_sizes=[(part.half_x, part.half_y, body.spec.height_m / 2) for part in parts],
                quaternions=[rerun.Quaternion(xyzw=about_z(part.yaw)) for part in parts],
                colors=[tuple(round(255 * share) for share in COLOURS[body.role])] * len(parts),
            ),
        )
