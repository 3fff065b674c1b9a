"""The world: two iiwa arms, I/L/T objects, five kinds of steps. It imports only schema, grid and errors of ours.

Everything here decides outcomes or observations, and nothing draws a picture. Reading order:

1. ``parameters``: every constant. ``shapes``, ``planar``, ``footprints``: geometry.
2. ``kinematics``, ``motion``: joints of an arm, and paths of its hand.
3. ``robots``, ``world``: arms and objects in PyBullet.
4. ``staging``, ``attempt``: what stands where, and a world in which one step is being carried out.
5. ``kinds``: everything that differs between kinds of steps, one object each; ``kinds.base`` is the list of questions.
6. ``reach`` (which actions an arm can carry out), ``observation`` (what a policy sees), ``simulator`` (what an action
   does), ``spawn`` (which objects are drawn), ``reference`` (the privileged picks): each asks the kind.
7. ``fingerprint``: which simulator this is.
"""

DECIDES = ("evaluator.sim", "rema_data.grid", "rema_data.schema", "rema_data.variation")
"""Packages and modules whose code decides outcomes and observations.

The identity of a collection and of an observation cache is the digest of their source
(``evaluator.rollout.backend``): a change of a picture must not stop a collection, a change of a kind of step must.
"""
