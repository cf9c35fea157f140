"""The paper's question in space: antagonistic rings against rings of one kind, all round and under forces all over."""
