"""The likelihood of logs of trains."""
