"""The API of a service: HTTP and WebSocket on this machine. Only the API's own process imports it."""
