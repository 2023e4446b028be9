"""The shell of the ground station: NiceGUI's pages, the SDK's messages, and the server of both."""
