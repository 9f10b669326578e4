"""Files of other tools: what they read of ours and we of theirs, one folder per tool."""
