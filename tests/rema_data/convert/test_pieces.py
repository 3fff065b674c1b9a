"""A block in pieces is the block, whatever the size of the pieces."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from rema_data.convert.pieces import read_pieces
from rema_data.errors import IntegrityError
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockReader, BlockWriter
from rema_data.store.tables import to_parquet
from tests.rema_data.convert.conftest import files

TRAIN = "round-1/grasp_grasp_push/train"


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_pieces_make_the_same_block(size: int, release: ReleaseFolder, tmp_path: Path) -> None:
    reader = BlockReader(release.path / TRAIN)
    writer = BlockWriter(tmp_path / "block")
    pieces = list(read_pieces(reader, size))
    for piece in pieces:
        assert piece.steps.num_rows == pc.sum(piece.episodes["steps"]).as_py()
        assert piece.steps.num_rows <= size or piece.episodes.num_rows == 1
        writer.append(*piece)
    writer.close()
    assert (len(pieces) == 1) == (size == 1000)
    assert files(tmp_path / "block") == files(reader.folder)


@pytest.mark.parametrize(("column", "shift"), [("scene_row", 1), ("ee_row", 10_000), ("first_step", 1)])
def test_tables_that_contradict_the_maps_are_refused(
    column: str, shift: int, release: ReleaseFolder, tmp_path: Path
) -> None:
    folder = shutil.copytree(release.path / TRAIN, tmp_path / "block")
    reader = BlockReader(folder)
    table = reader.episodes() if column == "first_step" else reader.steps()
    position = table.schema.get_field_index(column)
    values = pa.array(table[column].to_numpy() + np.int32(shift))
    path = folder / ("episodes.parquet" if column == "first_step" else "steps.parquet")
    path.unlink()
    path.write_bytes(to_parquet(table.set_column(position, table.schema.field(position), values)))
    with pytest.raises(IntegrityError, match="contradict each other") as error:
        list(read_pieces(reader))
    assert "rema verify" in error.value.hint
