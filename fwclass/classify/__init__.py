"""Classes of echoes by a trained model: shares, confidence, layers in context, a mean field, lines."""
