"""A dataset that answers with the rows it is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from tests.rema_data.samplers.tables import Table


class Rows(torch.utils.data.Dataset[torch.Tensor]):
    """A dataset whose batch is the rows themselves."""

    def __init__(self, columns: Table) -> None:
        self.table = columns
        self.fingerprint = "rows"

    def __len__(self) -> int:
        return len(self.table["task"])

    def __getitem__(self, row: int) -> torch.Tensor:
        return torch.tensor(row)

    def __getitems__(self, rows: Any) -> list[torch.Tensor]:
        return list(torch.as_tensor(np.asarray(rows)))
