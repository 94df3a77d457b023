"""Learned policies: recipes, training, export, loading. Only this package knows torch and SB3."""

from qcar_env.agents.load import entries

__all__ = ["entries"]
