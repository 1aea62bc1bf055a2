"""Accuracy and speed: what the README claims, measured."""
