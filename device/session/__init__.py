"""The instrument in use, without a face: what it knows, what happens, what it can be told to do."""
