"""Checks of what others hand in: conformance of a method, and the doctor that says what is wrong with a motion file."""
