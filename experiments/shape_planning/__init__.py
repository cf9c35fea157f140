"""The paper's shape study, Fig. 6: three shapes for one tip pose, and which of them an arm can hold."""
