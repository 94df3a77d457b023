"""Evaluation: what a policy is, rollouts through the environment, and metrics."""
