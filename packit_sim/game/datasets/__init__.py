"""Files of packs: reading, writing and verification, and the files of the original PackIt."""
