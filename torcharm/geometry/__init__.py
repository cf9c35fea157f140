"""Rigid motions of the plane and of space, and the rod: from strains to poses.

`se2` and `se3` offer the same functions, so that whatever is written in terms of a group serves both:
poses are `(x, y, θ)` in the plane and 4x4 homogeneous matrices in space; twists `(l, γ, κ)` and
`(l, γ_y, γ_z, κ_x, κ_y, κ_z)`, wrenches `(f_x, f_y, m)` and `(f_x, f_y, f_z, m_x, m_y, m_z)`, linear before
angular. The plane is z = 0 of space.
"""
