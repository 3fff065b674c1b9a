"""Ask a policy, simulate its answers: what evaluation, audit, collection, scenario picking and previews share."""
