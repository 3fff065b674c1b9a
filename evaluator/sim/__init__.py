"""The world: two iiwa arms, I/L/T objects, two primitives. A leaf: of rema it imports only schema, grid and errors.

Reading order: ``parameters`` (every constant), ``shapes`` and ``planar`` (geometry), ``kinematics`` and ``reach``,
``robots`` and ``world`` (PyBullet), ``primitives`` (what an action does), ``simulator`` (puts it together),
``observation`` (what a policy sees), ``spawn`` (drawing objects), ``reference`` (the privileged tool picks).
"""
