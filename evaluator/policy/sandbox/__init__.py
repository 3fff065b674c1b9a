"""What confines a policy's process: files, network, memory and time. The evaluator's side and the process's own.

Read in this order: ``launch_spec`` (how the process is started), ``allowlist``, ``limits`` and ``wrapper`` (what it may
reach and use), ``kernel`` (Landlock and seccomp, inside the process), ``isolation`` (the level that was reached),
``resource_monitor`` and ``cleanup`` (while it runs and after).
"""
