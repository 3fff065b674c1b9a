"""The ReMa dataset: records, grid and errors shared by the world, the judge and the baselines."""
