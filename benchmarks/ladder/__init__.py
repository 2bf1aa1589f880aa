"""The swap ladder in the hand's rig: ``plan.py`` says what is scored."""
