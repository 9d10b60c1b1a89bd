"""Scoring a result against ground truth or held-out photos (metrics: README, "Measured")."""

from .evaluation import evaluate

__all__ = ["evaluate"]
