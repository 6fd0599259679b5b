function bytes = plain_pack(head, reals, samples_v)
% Bytes (uint8, 40 + 8 n by 1) of a frame to the runner: what the block Byte Pack does with {'uint32','double','double'},
% alignment 1. head: six whole numbers; reals: time and output; samples_v: n samples in V. On a little-endian machine.
bytes = [typecast(uint32(head(:))', 'uint8'), typecast(double([reals(:); samples_v(:)])', 'uint8')]';
end
