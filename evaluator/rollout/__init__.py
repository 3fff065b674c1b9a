"""The one rollout: ask a policy, check its answers, simulate them, go on to the next step.

``episode`` goes from step to step; ``ask`` turns observations into a question and checks the answers; ``simulate``
turns actions into outcomes, through an engine; ``backend`` is the world and the host of policies, replaced by tests.
Evaluation, audit, collection, scenario picking, previews, reports and the Gymnasium environments use these.
"""
