"""Result folders: file names, record, reader."""
