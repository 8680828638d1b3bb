"""The studies behind pages of docs: a module and a command each."""
