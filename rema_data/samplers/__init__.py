"""Which rows a training loop sees, and in which order: a pure function of the table, the seed and the position.

Read in this order: ``strata`` (rows by label), ``shares`` (how much of the draws each stratum gets), ``epochs`` (how
long one is), ``plans`` (which strata make up a batch), ``walks`` (which row comes next in a stratum), ``passes``
(epochs and resuming), ``balanced`` (the sampler), ``report`` (what it will do to the data), ``evaluation`` (every row
once).
"""

from rema_data.samplers.balanced import BalancedSampler, FlatSampler
from rema_data.samplers.evaluation import EvaluationSampler
from rema_data.samplers.report import SamplerReport, StratumReport

__all__ = ["BalancedSampler", "EvaluationSampler", "FlatSampler", "SamplerReport", "StratumReport"]
