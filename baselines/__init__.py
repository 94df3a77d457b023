"""Scripted competitors: the control laws as policies with Stable-Baselines3's `predict`."""

from .catalogue import entries

__all__ = ["entries"]
