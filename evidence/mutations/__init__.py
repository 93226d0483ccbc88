"""Small slips put into the product's code one at a time: which of them does no test notice?"""
