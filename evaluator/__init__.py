"""The world (evaluator.sim) and the judge."""
