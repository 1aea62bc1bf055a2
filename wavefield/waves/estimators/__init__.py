"""Estimators, one subject a file: what each computes, and its products of an analysis."""
