"""Which rows a training loop sees, and in which order: a pure function of the table, the seed and the position.

Read in this order: ``source`` (what a sampler is given), ``strata`` (rows by label), ``shares`` (how much of the draws
each stratum gets), ``batch_plan`` (which strata make up a batch), ``row_order`` (which row comes next in a stratum),
``epoch_state`` (epochs and resuming), ``ranks`` (several processes), ``balanced`` (the sampler), ``report`` (what it
will do to the data).
"""

from rema_data.samplers.balanced import BalancedSampler
from rema_data.samplers.report import SamplerReport, StratumReport

__all__ = ["BalancedSampler", "SamplerReport", "StratumReport"]
