"""The contestants. The judge loads them by file, exactly as it loads a stranger's policy."""
