"""Checks of predictors: the methods of motion prediction."""
