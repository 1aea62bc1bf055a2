"""The stores of cubes and waves: layout, writing, reading, recipe, ledger, export."""
