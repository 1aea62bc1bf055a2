"""What all wave estimators share: records, segments, windows, rings, degrees of freedom, gains."""
