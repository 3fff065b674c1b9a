"""Training of TAE networks on a release."""
