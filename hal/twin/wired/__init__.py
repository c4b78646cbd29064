"""The twin seen from below: likenesses of chips, buses and libraries, on which the real drivers run over one bench."""
