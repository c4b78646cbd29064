"""What every compiled kernel needs: cache, parallel rows, planes."""
