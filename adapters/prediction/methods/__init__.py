"""The entry points of the predictors; nothing heavy is imported before one is loaded."""
