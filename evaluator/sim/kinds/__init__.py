"""The action primitives (paper, section 4.2): open-loop, parameterised by x, y and an angle."""
