"""Gymnasium environments: the task as pure functions, and the classes that keep the books."""
