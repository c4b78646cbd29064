"""From slopes to a height map: weighted multigrid with holes."""
