"""What a policy and an engine must keep, as pytest classes that other packages inherit in their own tests."""
