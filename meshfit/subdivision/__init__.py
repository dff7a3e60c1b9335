"""Layer 2: subdivision schemes as declared masks, and one assembler that lays them down as a sparse operator."""
