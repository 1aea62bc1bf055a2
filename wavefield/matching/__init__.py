"""Displacement from image a to image b on a lattice of blocks, from arrays alone.

`prepare` two images, then `match` them. The measurement evaluates the blocks again at a better displacement
(pyramid.py), weighs them against a learned spectrum (spectrum.py, map_field.py) and
computes the variance of the result (blocks.py, map_variance.py). Loops over pixels are in kernels.py, loops
over blocks in blocks.py.

Terms:

* lattice of blocks: image a divided into squares of 5 x 5 px; every block has one displacement d;
* residual: r = a(x) - b(x + d), for the pixels of a block;
* score s: sums over a block of gx r and gy r, with g the image gradient; 0 where the block alone fits best;
* Hessian H: sums over a block of gx gx, gx gy, gy gy; the block's own correction of d is H^-1 s;
* noise of the scores nu: their variance per unit of H;
* information A = H / nu: inverse variance of the block's own displacement; in a hole, A is 0 or small;
* footprint F: gain, as a function of wavenumber, of averaging over the area that a block's value represents;
* prior: the spectrum S of the field, learned once per record, with the typical information of a block;
* MAP field (maximum a posteriori): the most probable field, given the scores of all blocks and the prior;
* to refine a spectrum: to compute it again from the MAP fields that a previous spectrum gave.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
