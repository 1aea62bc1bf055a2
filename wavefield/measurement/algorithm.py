"""The version of the measurement, part of every cube's recipe."""

# Raise it with every change that alters the values of a cube. A cube that was begun with another version is
# then not continued.
ALGORITHM = 46
