"""The pair recorder's score against the simulator's truth, and the training of its force readers."""
