"""Result tables: grouping, comparisons, layout and formats."""
