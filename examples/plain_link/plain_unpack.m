function [arrived, head, reals] = plain_unpack(bytes)
% Whole numbers and reals of a frame from the runner: what the block Byte Unpack does with dimensions {6, 2} and types
% {'uint32','double'}, alignment 1. bytes: uint8; arrived is false where they are not 40. On a little-endian machine.
arrived = numel(bytes) == 40;
head = zeros(6, 1, 'uint32');
reals = zeros(2, 1);
if arrived
    head = reshape(typecast(reshape(uint8(bytes(1:24)), 1, 24), 'uint32'), 6, 1);
    reals = reshape(typecast(reshape(uint8(bytes(25:40)), 1, 16), 'double'), 2, 1);
end
end
