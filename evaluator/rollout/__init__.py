"""The one rollout: ask a policy, check its answers, simulate them, go on to the next step.

``episode``
    from step to step: where a protocol begins, and what follows an outcome
``ask``
    observations of one step become a question, and the answers come back checked: an action or a fault
``simulate``
    actions become outcomes, through an engine
``backend``
    the world and the host of policies; tests replace them

Evaluation, audit, collection, scenario picking, previews, reports and the Gymnasium environments use these.
"""
