"""Common part of every compiled kernel: cache, parallel rows, planes."""
