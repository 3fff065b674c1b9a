"""``python -m tests.mutations``."""

from tests.mutations.trial import main

if __name__ == "__main__":
    main()
