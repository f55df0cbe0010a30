"""Training configurations of the text-to-motion evaluator."""
