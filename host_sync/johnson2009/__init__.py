"""The method of Johnson & Adelson (CVPR 2009), complete."""
