"""The swap ladder and the arms of level ``touch``: ``plan.py`` says what is scored."""
