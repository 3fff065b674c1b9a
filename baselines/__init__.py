"""The baselines. The evaluator loads them by file and in the sandbox, as it loads a submitted policy."""
