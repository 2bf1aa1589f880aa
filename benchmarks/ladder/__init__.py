"""The swap ladder and the arms of level ``touch``: what is scored stands in ``plan.py`` before anything is trained."""
