"""Scripted competitors: the control laws as policies with Stable-Baselines3's `predict`."""
