"""Pictures and texts in terminal cells, without textual."""
