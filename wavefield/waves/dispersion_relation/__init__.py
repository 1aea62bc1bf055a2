"""The dispersion relation: fit of current and surface tension, current by depth, directions."""
