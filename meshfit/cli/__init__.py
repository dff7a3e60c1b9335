"""The commands: each module parses options, calls the library and prints. Nothing else prints or exits."""
