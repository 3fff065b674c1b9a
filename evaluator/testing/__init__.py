"""What policies and engines must keep, as pytest mixins that you run on your own: see ``engines`` and ``policies``."""
