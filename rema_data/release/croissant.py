"""The Croissant 1.1 description of a release: files with their sha256, and the columns of both tables with their types.

The tables can be read through it (``mlcroissant``) where the files of the release lie. Zarr arrays are listed as files:
Croissant has no way to read them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from rema_data.release.datasheet import has_varied
from rema_data.release.licences import licence_url
from rema_data.release.manifest import FileEntry, Manifest
from rema_data.store.block import EPISODES, STEPS
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column, columns_at

__all__ = ["croissant"]

_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The standard context of Croissant 1.1."""

_PARQUET = "application/x-parquet"
_ZARR = "application/vnd.zarr"
_TYPES = {
    "string": "sc:Text",
    "bool": "sc:Boolean",
    "int8": "cr:Int8",
    "int16": "cr:Int16",
    "int32": "cr:Int32",
    "uint8": "cr:UInt8",
    "uint16": "cr:UInt16",
    "uint64": "cr:UInt64",
    "float64": "cr:Float64",
}
_TABLES = (
    ("episodes", EPISODES, EPISODE_COLUMNS, "One record an episode.", ("task", "round", "split", "episode")),
    ("steps", STEPS, STEP_COLUMNS, "One record an executed step.", ("task", "round", "split", "episode", "step")),
)
_MAPS = (
    ("scene", "scene height maps: uint16 (steps, 64, 64), one row a step (column scene_row)"),
    ("ee_depth", "end-effector heights: uint16 (maps, 2, 112, 112), two states (column ee_row)"),
    ("ee_mask", "end-effector masks: uint8 (maps, 2, 112, 14), two states, eight pixels a byte (column ee_row)"),
)


def croissant(manifest: Manifest, beside: bool = False, version: int | None = None) -> dict[str, Any]:
    """Croissant description of a release as a JSON-LD object; ``manifest`` is a draft that lists the data files.

    Files of blocks that lie in the folder of an earlier release are listed too; the records are those of the release's
    own folder. ``beside``: the description will lie beside the folders of the releases instead, and its records are
    those of all of them. Records have the columns of ``version``, the earliest schema version of these tables; by
    default that of the release.
    """
    version = manifest.schema_version if version is None else version
    dated = {"datePublished": manifest.published} if manifest.published else {}
    based = {} if manifest.parent is None or beside else {"isBasedOn": f"../{manifest.parent.name}/croissant.json"}
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": manifest.name,
        "alternateName": manifest.title,
        "description": f"{manifest.description} Sizes and hashes of all files stand in manifest.json.",
        "license": licence_url(manifest.license),
        "citeAs": manifest.citation,
        "creator": {"@type": "Organization", "name": f"The authors of {manifest.name}"},
        **dated,
        **based,
        "version": _version(manifest.name),
        "keywords": ["robot learning", "manipulation", "tool use", "height maps", "offline dataset"],
        "isLiveDataset": False,
        **_RESPONSIBLE,
        **(_VARIED if has_varied(manifest) else {}),
        "distribution": [*_tables(manifest, beside), *_file_sets("*/" if beside else "")],
        "recordSet": [
            _record_set(name, file, columns_at(columns, version), meaning, key)
            for name, file, columns, meaning, key in _TABLES
        ],
    }


def _version(name: str) -> str:
    """A release never changes under its name: ``-v2`` is 2.0.0, and a name without a number 1.0.0."""
    found = re.search(r"-v(\d{1,4})$", name)
    return f"{int(found[1]) if found else 1}.0.0"


def _tables(manifest: Manifest, beside: bool) -> Iterator[dict[str, Any]]:
    for file in manifest.files:
        if file.path.endswith(".parquet"):
            yield {
                "@type": "cr:FileObject",
                "@id": file.path,
                "name": file.path,
                "contentUrl": file.location if beside else _url(file, manifest),
                "contentSize": f"{file.bytes} B",
                "encodingFormat": _PARQUET,
                "sha256": file.sha256,
            }


def _url(file: FileEntry, manifest: Manifest) -> str:
    """Relative to the folder in which the description lies."""
    return file.path if file.holder == manifest.name else f"../{file.location}"


def _file_sets(within: str) -> Iterator[dict[str, Any]]:
    for name, file, _, _, _ in _TABLES:
        yield _file_set(f"{name}-tables", f"{file} of every block", _PARQUET, f"{within}round-*/*/*/{file}")
    for name, meaning in _MAPS:
        shards = f"{within}round-*/*/*/maps.zarr/{name}/c/**"
        yield _file_set(f"{name}-shards", f"Zarr v3 shards of {meaning}", _ZARR, shards)
    metadata = (f"{within}round-*/*/*/maps.zarr/zarr.json", f"{within}round-*/*/*/maps.zarr/*/zarr.json")
    yield _file_set("zarr-metadata", "Zarr v3 metadata of the maps", "application/json", *metadata)


def _file_set(name: str, description: str, encoding: str, *includes: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": description,
        "encodingFormat": encoding,
        "includes": list(includes),
    }


def _record_set(
    name: str, file: str, columns: tuple[Column, ...], meaning: str, key: tuple[str, ...]
) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": f"{meaning} A row of {file}.",
        "key": [{"@id": f"{name}/{column}"} for column in key],
        "field": [_field(name, column) for column in columns],
    }


def _field(table: str, column: Column) -> dict[str, Any]:
    kind: str | list[str] = _TYPES[column.type]
    if column.name == "split":
        kind = ["sc:Text", "cr:Split"]
    notes = [f"unit {column.unit}"] if column.unit else []
    notes += [f"{column.frame} frame"] if column.frame else []
    notes += ["may be null"] if column.nullable else []
    return {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": column.name,
        "description": column.meaning + (f" ({', '.join(notes)})" if notes else ""),
        "dataType": kind,
        "source": {"fileSet": {"@id": f"{table}-tables"}, "extract": {"column": column.name}},
    }


_RESPONSIBLE = {
    "rai:dataCollection": "Episodes of two robot arms in the PyBullet simulator. Behaviour policies act, the simulator "
    "labels every executed step with success or one failure label and its evidence.",
    "rai:dataCollectionType": ["Simulations"],
    "rai:dataPreprocessingProtocol": [
        "Heights are stored as fixed-point numbers of 0.1 mm; equal end-effector maps of a block are stored once."
    ],
    "rai:dataAnnotationProtocol": ["Labels are measured in the simulator; nobody annotated anything by hand."],
    "rai:dataUseCases": ["Offline learning of grasping and pushing with grippers and with held tools."],
    "rai:dataLimitations": [
        "Simulation without sensor noise, three families of flat objects, open-loop actions on a discrete grid."
    ],
    "rai:dataBiases": [
        "The behaviour policies decide which actions were tried: random policies give few positives. Steps with tools "
        "exist only where the tools had been picked successfully."
    ],
    "rai:personalSensitiveInformation": ["None."],
    "rai:dataReleaseMaintenancePlan": "A release never changes. Corrections and additions are new releases.",
}
_VARIED = {
    "rai:dataLimitations": [
        "Simulation, open-loop actions on a discrete grid. Clean episodes have no sensor noise and three families of "
        "flat objects; in a varied one (column variation) one such thing is changed in the last step."
    ],
}
"""Of a release with varied episodes, in place of what is said of the others."""
