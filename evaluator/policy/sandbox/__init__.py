"""What confines a policy's process: files, network, memory and time. The evaluator's side and the process's own."""
