"""Learned policies: recipes, training, export, loading. Only this package knows torch and SB3."""
