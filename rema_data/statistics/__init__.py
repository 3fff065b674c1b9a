"""What a release holds, in numbers: ``count`` (the table), ``paper`` (beside the published one), ``plot``."""
