"""The instrument without a user interface: state, events, commands, worker."""
