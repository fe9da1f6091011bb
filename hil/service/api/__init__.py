"""The API of a service: HTTP and WebSocket on this machine. Imported by its own process only, and by nothing else."""
