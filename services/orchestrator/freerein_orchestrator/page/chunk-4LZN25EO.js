import{f as o}from"/web/chunk-Y5P5HXBZ.js";var t=o("");function r(i){t.value=i}export{t as a,r as b};
