"""Folders that other gel sensors' programs wrote, as frame sets beside the untouched originals."""
