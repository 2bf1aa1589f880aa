"""The pair recorder's score against the simulator, and the training of its force readers."""
