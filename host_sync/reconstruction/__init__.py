"""From intensity to height: gradients, gate, weights, multigrid."""
