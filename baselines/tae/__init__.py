"""Tool as Embodiment: the network of the paper, its checkpoints and its policies."""
